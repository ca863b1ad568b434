//! What devices send as depth images: packets and bytes in, images and named faults out. No socket, no clock
//! (docs/sensor-interface.md, "Adapters").

mod clock;
mod depth_stream;
mod fault;
mod metadata;
mod pose_track;
mod scan;

pub use clock::DeviceClock;
pub use depth_stream::DepthStream;
pub use fault::{Fault, Tally};
pub use metadata::{MetadataError, OusterDevice};
pub use pose_track::PoseTrack;
pub use scan::{OusterAdapter, SetupError};
