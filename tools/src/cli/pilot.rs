//! Which pilot flies: the arguments that `vigil fly` and `vigil evaluate` share.

pub use vigil_firmware::arguments::PilotArgs;
