//! An item of a plan as MISSION_ITEM_INT and MISSION_ITEM carry it. Read raw: the crate's types refuse commands and frames
//! that they do not know, but such an item must be answered.

use crate::core::padded;
use crate::geo::{self, BELOW_HOME_M, MAX_DISTANCE_M, MAX_HEIGHT_M, is_global};
use crate::plan::PlanDefect;
use vigil_mavlink::common::{MISSION_ITEM_DATA, MISSION_ITEM_INT_DATA, MavMissionResult};
use vigil_mavlink::mavlink::MessageData;
use vigil_types::settings;
use vigil_types::settings::required;

/// A frame that there is not.
const NO_FRAME: u8 = u8::MAX;
/// Length of the payload of both messages, their extension included.
pub(crate) const ITEM_PAYLOAD_LEN: usize = 38;

settings! {
    /// An item. Parameters 1 to 4 are NaN where they are not given.
    #[derive(Copy)]
    pub(crate) struct PlanItem {
        /// MAV_CMD.
        pub command: u16 = required(),
        /// MAV_FRAME.
        pub frame: u8 = required(),
        pub autocontinue: u8 = required(),
        pub params: [f32; 4] = required(),
        /// Parameters 5 and 6: degrees · 1e7 in a global frame, else as they are. The largest integer stands for NaN.
        pub x: i32 = required(),
        pub y: i32 = required(),
        pub z: f32 = required(),
    }
}

/// A place relative to home.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Place {
    /// Metres north and east; `None` is "where the vehicle is".
    pub north_east_m: Option<(f32, f32)>,
    /// Metres above home; `None` is "at the vehicle's height".
    pub height_m: Option<f32>,
}

/// What an item's packet holds besides the item.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Envelope {
    pub seq: u16,
    pub current: u8,
    pub mission_type: u8,
}

impl Envelope {
    /// Whether it is ArduPilot's "go there now", or its "go to this altitude now".
    pub fn is_go_to(self) -> bool {
        matches!(self.current, 2 | 3)
    }
}

impl PlanItem {
    /// Reads the payload of either message; `None` if it is another message.
    pub fn read(message_id: u32, payload: &[u8]) -> Option<(Self, Envelope)> {
        let p = padded::<ITEM_PAYLOAD_LEN>(payload);
        let word = |at: usize| [p[at], p[at + 1], p[at + 2], p[at + 3]];
        let float = |at: usize| f32::from_le_bytes(word(at));
        // The form with fractions has frames of its own, 0 and 3, as in PX4.
        let frame = match (message_id, p[34]) {
            (MISSION_ITEM_DATA::ID, 5 | 6) => NO_FRAME,
            (_, frame) => frame,
        };
        let (x, y) = match message_id {
            MISSION_ITEM_INT_DATA::ID => (i32::from_le_bytes(word(16)), i32::from_le_bytes(word(20))),
            MISSION_ITEM_DATA::ID => {
                let scale = if is_global(frame) { 1e7 } else { 1.0 };
                // What is too large, such as degrees · 1e7, must not become what stands for NaN.
                let integer = |v: f32| {
                    if v.is_finite() {
                        (libm::round(f64::from(v) * scale) as i32).clamp(i32::MIN + 1, i32::MAX - 1)
                    } else {
                        i32::MAX
                    }
                };
                (integer(float(16)), integer(float(20)))
            }
            _ => return None,
        };
        let item = Self {
            command: u16::from_le_bytes([p[30], p[31]]),
            frame,
            autocontinue: p[36],
            params: [float(0), float(4), float(8), float(12)],
            x,
            y,
            z: float(24),
        };
        let envelope = Envelope {
            seq: u16::from_le_bytes([p[28], p[29]]),
            current: p[35],
            mission_type: p[37],
        };
        Some((item, envelope))
    }

    /// The payload of MISSION_ITEM_INT, or of MISSION_ITEM, each with its own form of a global frame.
    pub fn payload(&self, e: Envelope, (system, component): (u8, u8), as_int: bool) -> [u8; ITEM_PAYLOAD_LEN] {
        let scale = if is_global(self.frame) { 1e-7 } else { 1.0 };
        let coordinate = |v: i32| match (as_int, v) {
            (true, v) => v.to_le_bytes(),
            (false, i32::MAX) => f32::NAN.to_le_bytes(),
            (false, v) => ((f64::from(v) * scale) as f32).to_le_bytes(),
        };
        let frame = match (self.frame, as_int) {
            (0, true) => 5,
            (3, true) => 6,
            (5, false) => 0,
            (6, false) => 3,
            (frame, _) => frame,
        };
        let ([p1, p2, p3, p4], [x, y]) = (self.params.map(f32::to_le_bytes), [self.x, self.y].map(coordinate));
        let numbers = [p1, p2, p3, p4, x, y, self.z.to_le_bytes()];
        let words = [e.seq, self.command].map(u16::to_le_bytes);
        let bytes = [system, component, frame, e.current, self.autocontinue, e.mission_type];
        padded(&[numbers.as_flattened(), words.as_flattened(), &bytes].concat())
    }

    /// The bytes that make items equal.
    pub fn content(&self) -> [u8; ITEM_PAYLOAD_LEN] {
        self.payload(Envelope::default(), (0, 0), true)
    }

    /// Parameter 1 to 4; `None` if it is NaN.
    pub fn param(&self, number: usize) -> Option<f32> {
        self.params.get(number.checked_sub(1)?).copied().filter(|p| !p.is_nan())
    }

    /// Parameters 5 and 6 as metres north and east of home; `None` where both are zero or not given.
    pub fn north_east_m(&self) -> Result<Option<(f32, f32)>, PlanDefect> {
        if !is_global(self.frame) {
            let result = MavMissionResult::MAV_MISSION_UNSUPPORTED_FRAME;
            return Err(PlanDefect::new(result, "frame is not global"));
        }
        let unset = |v: i32| v == i32::MAX;
        if unset(self.x) || unset(self.y) || (self.x == 0 && self.y == 0) {
            return Ok(None);
        }
        let (lat, lon) = (f64::from(self.x) * 1e-7, f64::from(self.y) * 1e-7);
        if lat.abs() > 90.0 {
            return Err(PlanDefect::of_parameter(5, "no such latitude"));
        }
        if lon.abs() > 180.0 {
            return Err(PlanDefect::of_parameter(6, "no such longitude"));
        }
        let (north, east) = geo::ORIGIN.north_east_m(lat, lon);
        // NaN fails the comparison.
        if libm::hypotf(north, east) <= MAX_DISTANCE_M {
            Ok(Some((north, east)))
        } else {
            Err(PlanDefect::of_parameter(5, "too far from home"))
        }
    }

    /// Where parameters 5 to 7 are.
    pub fn place(&self) -> Result<Place, PlanDefect> {
        let north_east_m = self.north_east_m()?;
        let height_m = if matches!(self.frame, 3 | 6) {
            self.z
        } else {
            geo::height_m(self.z)
        };
        if height_m.abs() > MAX_HEIGHT_M {
            return Err(PlanDefect::of_parameter(7, "height beyond 500 m"));
        }
        if height_m < -BELOW_HOME_M {
            return Err(PlanDefect::of_parameter(7, "below home; frames 3 and 6 count from it"));
        }
        Ok(Place {
            north_east_m,
            height_m: (!height_m.is_nan()).then_some(height_m),
        })
    }

    /// Metres north and east of home where coordinates are needed and the height means nothing.
    pub fn point(&self) -> Result<(f32, f32), PlanDefect> {
        self.north_east_m()?
            .ok_or(PlanDefect::of_parameter(5, "no coordinates"))
    }
}
