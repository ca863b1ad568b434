//! Lockstep between two processes: the simulator asks (client), the firmware answers (server), one step at a time.

use super::Domain;
use iceoryx2::port::client::Client;
use iceoryx2::port::listener::Listener;
use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::server::Server;
use iceoryx2::prelude::*;
use iceoryx2::service::builder::request_response::{RequestResponseOpenError, RequestResponseOpenOrCreateError};
use iceoryx2::service::port_factory::{client::ClientCreateError, request_response, server::ServerCreateError};
use std::fmt::Display;
use std::time::{Duration, Instant};
use vigil_types::{Datagrams, DepthFrame, Nanos};

const SERVICE: &str = "lockstep";
const REQUEST_EVENT: &str = "lockstep-request";
const ANSWER_EVENT: &str = "lockstep-answer";
/// How long a wait lasts at most before it looks whether it was cancelled or the other side came or went.
const WAIT_SLICE: Duration = Duration::from_millis(50);

/// Why a lockstep exchange failed.
#[derive(Debug, thiserror::Error)]
pub enum LockstepError {
    /// The simulator's `cancelled` said so.
    #[error("interrupted")]
    Cancelled,
    /// The other side is not there, is silent or of another version, the role is taken, or the transport refuses.
    #[error("{0}")]
    Failed(String),
}

#[derive(Debug)]
#[repr(C)]
struct WireRequest {
    step: u64,
    now_ns: u64,
    /// 1 when no more steps come; what else is here means nothing then.
    finishes: u32,
    /// 1 when `frame` is new in this step.
    has_frame: u32,
    received: Datagrams,
    frame: DepthFrame,
}

#[derive(Debug)]
#[repr(C)]
struct WireResponse {
    step: u64,
    sent: Datagrams,
}

// SAFETY: both are `repr(C)` plain data without pointers or invalid bit patterns (the frame: see `ShmFrame`).
unsafe impl ZeroCopySend for WireRequest {
    unsafe fn type_name() -> &'static str {
        "vigil_lockstep_request_v3"
    }
}
// SAFETY: as above.
unsafe impl ZeroCopySend for WireResponse {
    unsafe fn type_name() -> &'static str {
        "vigil_lockstep_response_v2"
    }
}

type Factory = request_response::PortFactory<ipc::Service, WireRequest, (), WireResponse, ()>;

struct Bell {
    listener: Listener<ipc::Service>,
    notifier: Notifier<ipc::Service>,
}

fn transport_error(instance: u32, action: &str, reason: impl Display) -> LockstepError {
    LockstepError::Failed(format!("lockstep on instance {instance}: cannot {action}: {reason}"))
}

fn role_taken(instance: u32, role: &str) -> LockstepError {
    LockstepError::Failed(format!(
        "another {role} already runs lockstep on instance {instance}: stop it, or use another --instance"
    ))
}

fn malformed(who: &str, step: u64) -> LockstepError {
    LockstepError::Failed(format!(
        "{who} sent a malformed message at step {step}: is it of the same version of Vigil?"
    ))
}

fn service_name(instance: u32, name: &str) -> Result<ServiceName, LockstepError> {
    ServiceName::new(name).map_err(|e| transport_error(instance, "use this name", format!("{e:?}")))
}

fn open(domain: &Domain) -> Result<Factory, LockstepError> {
    let instance = domain.instance();
    domain
        .node()
        .service_builder(&service_name(instance, SERVICE)?)
        .request_response::<WireRequest, WireResponse>()
        .max_clients(1)
        .max_servers(1)
        .max_active_requests_per_client(1)
        .max_response_buffer_size(1)
        .open_or_create()
        .map_err(|e| match e {
            RequestResponseOpenOrCreateError::RequestResponseOpenError(
                reason @ (RequestResponseOpenError::IncompatibleRequestOrResponseType
                | RequestResponseOpenError::IncompatibleMessagingPattern
                | RequestResponseOpenError::VersionMismatch),
            ) => LockstepError::Failed(format!(
                "lockstep on instance {instance} carries another type of data ({reason}): the other process is of \
                 another version of Vigil"
            )),
            other => transport_error(instance, "open the service", other),
        })
}

impl Bell {
    fn open(domain: &Domain, listens_to: &str, rings: &str) -> Result<Self, LockstepError> {
        let instance = domain.instance();
        let event = |name: &str| -> Result<_, LockstepError> {
            domain
                .node()
                .service_builder(&service_name(instance, name)?)
                .event()
                .open_or_create()
                .map_err(|e| transport_error(instance, "open the wake-up service", e))
        };
        Ok(Self {
            listener: event(listens_to)?
                .listener_builder()
                .create()
                .map_err(|e| transport_error(instance, "listen for wake-ups", e))?,
            notifier: event(rings)?
                .notifier_builder()
                .create()
                .map_err(|e| transport_error(instance, "prepare wake-ups", e))?,
        })
    }

    /// Wakes the other side. A failure only costs it a part of its [`WAIT_SLICE`].
    fn ring(&self) {
        let _ = self.notifier.notify();
    }

    /// Waits for what `receive` gives, at most `timeout`; the error then says who was `silent` for so many seconds. `cancelled` is asked a
    /// few times a second.
    fn wait_for<T>(
        &self,
        timeout: Duration,
        mut cancelled: impl FnMut() -> bool,
        mut receive: impl FnMut() -> Result<Option<T>, LockstepError>,
        silent: impl FnOnce(f64) -> String,
    ) -> Result<T, LockstepError> {
        let deadline = Instant::now() + timeout;
        loop {
            if let Some(found) = receive()? {
                return Ok(found);
            }
            if cancelled() {
                return Err(LockstepError::Cancelled);
            }
            if Instant::now() >= deadline {
                return Err(LockstepError::Failed(silent(timeout.as_secs_f64())));
            }
            let left = deadline.saturating_duration_since(Instant::now()).min(WAIT_SLICE);
            let _ = self.listener.timed_wait(|_| {}, left);
        }
    }
}

/// The simulator's end: asks the firmware for each step.
pub struct LockstepClient {
    // Declared before the factory, so that it is dropped first.
    client: Client<ipc::Service, WireRequest, (), WireResponse, ()>,
    factory: Factory,
    bell: Bell,
    instance: u32,
    timeout: Duration,
    cancelled: Box<dyn Fn() -> bool>,
}

impl LockstepClient {
    /// Becomes the simulator of this instance and waits for the firmware, at most `timeout`, which also bounds each
    /// later exchange. `cancelled` ends any of these waits; it is asked a few times a second.
    ///
    /// # Errors
    /// [`LockstepError`], also when no firmware came.
    pub fn connect(
        domain: &Domain,
        timeout: Duration,
        cancelled: impl Fn() -> bool + 'static,
    ) -> Result<Self, LockstepError> {
        let instance = domain.instance();
        let factory = open(domain)?;
        let bell = Bell::open(domain, ANSWER_EVENT, REQUEST_EVENT)?;
        let client = factory.client_builder().create().map_err(|e| match e {
            ClientCreateError::ExceedsMaxSupportedClients => role_taken(instance, "simulator"),
            other => transport_error(instance, "create the client", other),
        })?;
        let this = Self {
            client,
            factory,
            bell,
            instance,
            timeout,
            cancelled: Box::new(cancelled),
        };
        let servers = || this.factory.dynamic_config().number_of_servers();
        let firmware = || Ok((servers() > 0).then_some(()));
        this.bell.wait_for(timeout, &this.cancelled, firmware, |waited_s| {
            format!(
                "no firmware came to lockstep on instance {instance} within {waited_s} s: start it with \
                 `--lockstep --instance {instance}`"
            )
        })?;
        Ok(this)
    }

    /// One step: hands time, a new frame if there is one, and the received datagrams to the firmware; fills `sent`
    /// with its answer.
    ///
    /// # Errors
    /// [`LockstepError`], naming the step at which the firmware was silent, or its answer malformed.
    pub fn exchange(
        &mut self,
        step: u64,
        now_ns: Nanos,
        frame: Option<&DepthFrame>,
        received: &Datagrams,
        sent: &mut Datagrams,
    ) -> Result<(), LockstepError> {
        if (self.cancelled)() {
            return Err(LockstepError::Cancelled);
        }
        let fill = |request: &mut WireRequest| {
            request.now_ns = now_ns;
            request.received.copy_from(received);
            request.has_frame = u32::from(frame.is_some());
            if let Some(frame) = frame {
                request.frame.clone_from(frame);
            }
        };
        match self.ask(step, fill, |answer| answer.step == step && sent.copy_from(&answer.sent))? {
            true => Ok(()),
            false => Err(malformed("firmware", step)),
        }
    }

    /// Lets the firmware know that no more steps come and waits until it knows, whatever `cancelled` says.
    ///
    /// # Errors
    /// [`LockstepError`], naming the step given here.
    pub fn finish(mut self, step: u64) -> Result<(), LockstepError> {
        // Who interrupts a flight does not wait for a firmware that hangs.
        if (self.cancelled)() {
            self.timeout = self.timeout.min(Duration::from_secs(1));
        }
        self.cancelled = Box::new(|| false);
        self.ask(step, |request| request.finishes = 1, |_| ())
    }

    /// Sends what `fill` makes of an empty request and waits for the answer: what `read` makes of it.
    fn ask<T>(
        &self,
        step: u64,
        fill: impl FnOnce(&mut WireRequest),
        read: impl FnOnce(&WireResponse) -> T,
    ) -> Result<T, LockstepError> {
        let instance = self.instance;
        let request = self.client.loan_uninit();
        let request = request.map_err(|e| transport_error(instance, "loan memory", e))?;
        let mut request = request.write_payload(WireRequest {
            step,
            now_ns: 0,
            finishes: 0,
            has_frame: 0,
            received: Datagrams::default(),
            frame: DepthFrame::EMPTY,
        });
        fill(request.payload_mut());
        let pending = request.send().map_err(|e| transport_error(instance, "send", e))?;
        self.bell.ring();
        let answer = || pending.receive().map_err(|e| transport_error(instance, "receive", e));
        let silent = |waited_s| format!("firmware did not answer step {step} within {waited_s} s");
        let answer = self.bell.wait_for(self.timeout, &self.cancelled, answer, silent)?;
        Ok(read(&answer))
    }
}

/// A step as the firmware gets it.
#[derive(Debug, Clone, Copy)]
pub struct StepRequest<'a> {
    /// Number of the step.
    pub step: u64,
    /// Simulated time.
    pub now_ns: Nanos,
    /// The frame that is new in this step; unchecked.
    pub frame: Option<&'a DepthFrame>,
    /// What the links received since the last step.
    pub received: &'a Datagrams,
}

/// How a wait for a step ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Served {
    /// A step was answered.
    Step,
    /// The simulator said that no more steps come.
    Finished,
    /// `cancelled` said so.
    Cancelled,
}

/// The firmware's end: answers each step.
pub struct LockstepServer {
    server: Server<ipc::Service, WireRequest, (), WireResponse, ()>,
    bell: Bell,
    instance: u32,
    next_step: u64,
    received: Box<Datagrams>,
}

impl LockstepServer {
    /// Becomes the firmware of this instance.
    ///
    /// # Errors
    /// [`LockstepError`], also while another firmware serves.
    pub fn create(domain: &Domain) -> Result<Self, LockstepError> {
        let instance = domain.instance();
        let factory = open(domain)?;
        let bell = Bell::open(domain, REQUEST_EVENT, ANSWER_EVENT)?;
        let server = factory.server_builder().create().map_err(|e| match e {
            ServerCreateError::ExceedsMaxSupportedServers => role_taken(instance, "firmware"),
            other => transport_error(instance, "create the server", other),
        })?;
        // A simulator may be waiting for exactly this.
        bell.ring();
        Ok(Self {
            server,
            bell,
            instance,
            next_step: 0,
            received: Box::default(),
        })
    }

    /// Waits for one step, at most `timeout`, and answers it with the datagrams that `tick` gives. `cancelled` is asked a few times
    /// a second.
    ///
    /// # Errors
    /// [`LockstepError`], naming the step at which the simulator was silent, or its request malformed.
    pub fn serve<'a>(
        &mut self,
        timeout: Duration,
        cancelled: impl FnMut() -> bool,
        tick: impl FnOnce(StepRequest<'_>) -> &'a Datagrams,
    ) -> Result<Served, LockstepError> {
        let (instance, step) = (self.instance, self.next_step);
        let request = || {
            self.server
                .receive()
                .map_err(|e| transport_error(instance, "receive", e))
        };
        let silent = |waited_s| format!("simulator did not send step {step} within {waited_s} s");
        let request = match self.bell.wait_for(timeout, cancelled, request, silent) {
            Err(LockstepError::Cancelled) => return Ok(Served::Cancelled),
            request => request?,
        };
        let step = request.step;
        let response = request
            .loan_uninit()
            .map_err(|e| transport_error(self.instance, "loan memory", e))?;
        let mut response = response.write_payload(WireResponse {
            step,
            sent: Datagrams::default(),
        });
        let served = if request.finishes == 1 {
            Served::Finished
        } else {
            if !self.received.copy_from(&request.received) {
                return Err(malformed("simulator", step));
            }
            let sent = tick(StepRequest {
                step,
                now_ns: request.now_ns,
                frame: (request.has_frame != 0).then_some(&request.frame),
                received: &self.received,
            });
            response.payload_mut().sent.copy_from(sent);
            Served::Step
        };
        response.send().map_err(|e| transport_error(self.instance, "send", e))?;
        self.bell.ring();
        self.next_step = step + 1;
        Ok(served)
    }
}
