//! Layouts of what crosses between processes in lockstep.

use super::frames::ShmFrame;
use iceoryx2::prelude::ZeroCopySend;
use vigil_types::{Datagrams, DepthFrame};

#[derive(Debug)]
#[repr(C)]
pub(crate) struct WireRequest {
    pub(crate) step: u64,
    pub(crate) now_ns: u64,
    /// 1 when no more steps come; what else is here means nothing then.
    pub(crate) finishes: u32,
    /// 1 when `frame` is new in this step.
    pub(crate) has_frame: u32,
    pub(crate) received: Datagrams,
    pub(crate) frame: DepthFrame,
}

#[derive(Debug)]
#[repr(C)]
pub(crate) struct WireResponse {
    pub(crate) step: u64,
    pub(crate) sent: Datagrams,
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

const _: () = assert!(size_of::<ShmFrame>() == size_of::<DepthFrame>());
