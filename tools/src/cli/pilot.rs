//! Which pilot flies, and what beside the LiDAR looks ahead: the arguments that `vigil fly` and `vigil evaluate` share.

pub use vigil_firmware::arguments::PilotArgs;

/// The second sensor.
#[derive(Debug, Clone, Copy, Default, clap::Args)]
pub struct SecondSensorArgs {
    /// So many small sensors of 45° each beside the LiDAR, side by side, which must see nothing nearer than the frames show
    /// (docs/second-sensor.md).
    #[arg(long = "second-sensor-heads", value_name = "COUNT", default_value_t = 0, value_parser = clap::value_parser!(u8).range(0..=5))]
    pub heads: u8,
}
