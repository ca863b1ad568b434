//! The depth frame service: one publisher, any number of readers, newest frame wins.

use super::Domain;
use super::domain::{PUBLISHERS_ROOM, has_room};
use iceoryx2::port::publisher::{Publisher, PublisherCreateError};
use iceoryx2::port::subscriber::{Subscriber, SubscriberCreateError};
use iceoryx2::prelude::*;
use iceoryx2::sample::Sample;
use iceoryx2::service::builder::publish_subscribe::{PublishSubscribeOpenError, PublishSubscribeOpenOrCreateError};
use iceoryx2::service::port_factory::publish_subscribe;
use std::fmt::Display;
use std::ops::Deref;
use vigil_types::{DepthFrame, Nanos, STEP_NS};

/// The service on which the firmware expects its frames.
pub const DEPTH_TOPIC: &str = "depth";
/// What was captured longer ago is used by nobody: such a stamp is of another clock.
const OLDEST_NS: Nanos = 1_000_000_000;

/// Whether a frame of this stamp is worth publishing at `now_ns`: of the last second, and not of the future.
pub fn is_timely(stamp_ns: Nanos, now_ns: Nanos) -> bool {
    (now_ns.saturating_sub(OLDEST_NS)..=now_ns.saturating_add(STEP_NS)).contains(&stamp_ns)
}

/// Readers that may listen at the same time (firmware, recorders, displays).
const MAX_SUBSCRIBERS: usize = 8;

/// Publishers that can have left a frame behind in a reader's buffers; bounds the search for the newest one.
const MAX_PENDING: usize = 8;

/// A depth frame in shared memory.
#[repr(transparent)]
struct ShmFrame(DepthFrame);

// SAFETY: DepthFrame is `repr(C)` plain data without padding, pointers or invalid bit patterns (its tests assert the
// layout), so any process may read it, whatever bytes another one wrote.
unsafe impl ZeroCopySend for ShmFrame {
    unsafe fn type_name() -> &'static str {
        "vigil_depth_frame_v2"
    }
}

impl std::fmt::Debug for ShmFrame {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.0.header.fmt(f)
    }
}

/// Why frames cannot be published or received.
#[allow(missing_docs, reason = "the texts say what the fields are")]
#[derive(Debug, thiserror::Error)]
pub enum FrameError {
    /// Somebody already publishes here.
    #[error(
        "another process already publishes `{topic}` frames on instance {instance}: stop it, or use another --instance"
    )]
    AlreadyPublished { topic: String, instance: u32 },
    /// Too many read, the other processes are of another version, or the transport refuses.
    #[error("{0}")]
    Failed(String),
}

type Service = publish_subscribe::PortFactory<ipc::Service, ShmFrame, ()>;

/// Where frames are published: the service and the instance, as errors name them.
struct Place {
    topic: String,
    instance: u32,
}

impl Place {
    fn error(&self, action: &str, reason: impl Display) -> FrameError {
        let Self { topic, instance } = self;
        FrameError::Failed(format!(
            "`{topic}` frames on instance {instance}: cannot {action}: {reason}"
        ))
    }
}

fn open_service(domain: &Domain, topic: &str) -> Result<(Service, Place), FrameError> {
    let place = Place {
        topic: topic.to_owned(),
        instance: domain.instance(),
    };
    let name = ServiceName::new(topic).map_err(|e| place.error("use this name", format!("{e:?}")))?;
    let service = domain
        .node()
        .service_builder(&name)
        .publish_subscribe::<ShmFrame>()
        .enable_safe_overflow(true)
        .subscriber_max_buffer_size(1)
        // One in use by the reader, one while it fetches the next.
        .subscriber_max_borrowed_samples(2)
        .history_size(0)
        .max_publishers(1)
        .max_subscribers(MAX_SUBSCRIBERS)
        .open_or_create()
        .map_err(|e| match e {
            PublishSubscribeOpenOrCreateError::PublishSubscribeOpenError(
                reason @ (PublishSubscribeOpenError::IncompatibleTypes
                | PublishSubscribeOpenError::IncompatibleMessagingPattern
                | PublishSubscribeOpenError::VersionMismatch),
            ) => FrameError::Failed(format!(
                "`{topic}` on instance {} carries another type of data ({reason}): its other processes are of another \
                 version of Vigil; stop them, or use another --instance",
                place.instance
            )),
            other => place.error("open the service", other),
        })?;
    Ok((service, place))
}

/// The one source of frames on a topic.
pub struct FramePublisher {
    publisher: Publisher<ipc::Service, ShmFrame, ()>,
    place: Place,
}

impl FramePublisher {
    /// Becomes the publisher of `topic` ([`DEPTH_TOPIC`] is what the firmware reads).
    ///
    /// # Errors
    /// [`FrameError::AlreadyPublished`] while another process publishes; a killed one does not count.
    pub fn create(domain: &Domain, topic: &str) -> Result<Self, FrameError> {
        let (service, place) = open_service(domain, topic)?;
        has_room(PUBLISHERS_ROOM).map_err(|full| place.error("publish", full))?;
        let publisher = service.publisher_builder().create().map_err(|e| match e {
            PublisherCreateError::ExceedsMaxSupportedPublishers => FrameError::AlreadyPublished {
                topic: topic.to_owned(),
                instance: domain.instance(),
            },
            other => place.error("create the publisher", other),
        })?;
        Ok(Self { publisher, place })
    }

    /// Publishes what `fill` writes. It gets a frame in shared memory, [`DepthFrame::EMPTY`] at first, and must
    /// [`DepthFrame::seal`] it. Returns the number of readers it went to. Never waits for a reader.
    ///
    /// # Errors
    /// [`FrameError`].
    pub fn publish_with(&mut self, fill: impl FnOnce(&mut DepthFrame)) -> Result<usize, FrameError> {
        let sample = self
            .publisher
            .loan_uninit()
            .map_err(|e| self.place.error("loan memory", e))?;
        let mut sample = sample.write_payload(ShmFrame(DepthFrame::EMPTY));
        fill(&mut sample.payload_mut().0);
        sample.send().map_err(|e| self.place.error("send", e))
    }

    /// Publishes a copy of a sealed frame. Returns the number of readers it went to.
    ///
    /// # Errors
    /// [`FrameError`].
    pub fn publish(&mut self, frame: &DepthFrame) -> Result<usize, FrameError> {
        self.publish_with(|slot| slot.clone_from(frame))
    }
}

/// A reader of frames.
pub struct FrameSubscriber {
    subscriber: Subscriber<ipc::Service, ShmFrame, ()>,
    place: Place,
}

/// A frame in shared memory, given back when dropped. It is unchecked and, from a hostile publisher, may even change
/// while it is read: copy it, then call [`DepthFrame::check`] on the copy.
pub struct BorrowedFrame(Sample<ipc::Service, ShmFrame, ()>);

impl Deref for BorrowedFrame {
    type Target = DepthFrame;
    fn deref(&self) -> &DepthFrame {
        &self.0.payload().0
    }
}

impl FrameSubscriber {
    /// Starts to listen to `topic`; its publisher may come later, go, and come again.
    ///
    /// # Errors
    /// [`FrameError`].
    pub fn create(domain: &Domain, topic: &str) -> Result<Self, FrameError> {
        let (service, place) = open_service(domain, topic)?;
        let subscriber = service.subscriber_builder().create().map_err(|e| match e {
            SubscriberCreateError::ExceedsMaxSupportedSubscribers => FrameError::Failed(format!(
                "instance {} already has {MAX_SUBSCRIBERS} readers of `{topic}` frames: stop one of them",
                place.instance
            )),
            other => place.error("create the reader", other),
        })?;
        Ok(Self { subscriber, place })
    }

    /// The newest frame published since the last call, if any. Never waits; does not allocate in steady state
    /// (when a publisher appears, its memory is mapped).
    ///
    /// # Errors
    /// [`FrameError`]; the next call may succeed.
    pub fn newest(&mut self) -> Result<Option<BorrowedFrame>, FrameError> {
        let mut newest = None;
        for _ in 0..MAX_PENDING {
            match self.subscriber.receive() {
                Ok(Some(sample)) => newest = Some(BorrowedFrame(sample)),
                Ok(None) => break,
                Err(e) => return Err(self.place.error("receive", e)),
            }
        }
        Ok(newest)
    }
}
