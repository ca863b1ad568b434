//! A recorded flight as plain bytes, little-endian: what a machine without an operating system replays. The program that writes it
//! (`firmware/examples/flight_for_a_board.rs`) shares this file.

/// First bytes of a recording; the last one counts versions.
pub const MAGIC: [u8; 8] = *b"VIGILFL\x01";

/// FNV-1a over whatever is written: digests of printed values, without memory.
pub struct Digest(pub u64);

impl Digest {
    /// Digest of a value's exact printed form.
    pub fn of(value: &impl core::fmt::Debug) -> u64 {
        let mut digest = Self(0xcbf2_9ce4_8422_2325);
        // Writing to it cannot fail.
        let _ = core::fmt::write(&mut digest, format_args!("{value:?}"));
        digest.0
    }
}

impl core::fmt::Write for Digest {
    fn write_str(&mut self, text: &str) -> core::fmt::Result {
        for byte in text.bytes() {
            self.0 = (self.0 ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
        }
        Ok(())
    }
}

/// What the machine has to know beforehand. Everything else of its configuration is the default; [`Setup::config`] has a digest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Setup {
    /// Goal, metres from home: north, east, down.
    pub goal_ned_m: [f32; 3],
    /// Score above which a verdict is attack.
    pub threshold: f32,
    /// Whether the potential field is added to the actor's action.
    pub field: bool,
    /// [`Digest::of`] the configuration that flew.
    pub config: u64,
    /// Steps that follow.
    pub steps: u32,
}

impl Setup {
    /// The configuration of the flight: the default one that engages by itself and flies to the goal.
    pub fn stack(&self) -> vigil_firmware::stack::StackConfig {
        use vigil_types::{EngagePolicy, Goal, NedVector, parameters};
        let [north_m, east_m, down_m] = self.goal_ned_m;
        vigil_firmware::stack::StackConfig {
            sensor_id: parameters::SENSOR_ID.number() as u32,
            guidance: vigil_guidance::GuidanceConfig {
                engage: EngagePolicy::Auto,
                default_height_m: -down_m,
                ..Default::default()
            },
            companion: Default::default(),
            pilot: Default::default(),
            goal: Some(Goal {
                position_ned_m: NedVector::new(north_m, east_m, down_m),
            }),
            plausibility: parameters::PLAUSIBILITY.is_on(),
            second_sensor: parameters::SECOND_SENSOR.is_on(),
            duty: Default::default(),
            just_stop: Default::default(),
        }
    }
}

/// A frame is new in this step.
pub const HAS_FRAME: u32 = 1;
/// It was found unauthenticated when it arrived.
pub const KNOWN_ALTERED: u32 = 2;
