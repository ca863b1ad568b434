//! Records whose every field is drawn from a seed, NaN and all, and their bits for comparison.
#![allow(dead_code, reason = "each test file uses its part")]

use vigil_log::{FlightInfo, LogPlace, Recorder, RecorderConfig, Summary, TickRecord, WhenFull};
use vigil_types::{
    Action, Alarm, AlarmCause, AlarmResponse, Attitude, AttitudeSample, Datagrams, DepthFrame, Frame, FrameHeader,
    Goal, GoalRelative, GuidanceState, Heartbeat, Judgement, Kinematics, Landed, Reasons, StepReport, StepTiming,
    Vector, VehicleMode, VehicleTelemetry, VelocitySetpoint, Verdict,
};

/// What a record's fields are gone through with: those that are not given are drawn, and the bits of all are noted, field by field and
/// apart from the log's own encoding.
#[derive(Default)]
struct Pass {
    seed: u64,
    noted: Vec<u64>,
}

impl Pass {
    /// splitmix64.
    fn draw(&mut self) -> u64 {
        self.seed = self.seed.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.seed;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    fn below(&mut self, n: u64) -> u64 {
        self.draw() % n
    }

    fn bits(&mut self, given: Option<u64>, draw: impl FnOnce(&mut Self) -> u64) -> u64 {
        let bits = given.unwrap_or_else(|| draw(self));
        self.noted.push(bits);
        bits
    }
}

trait Part: Sized {
    fn pass(given: Option<&Self>, pass: &mut Pass) -> Self;
}

macro_rules! numbers {
    ($($type:ty),+) => {$(
        impl Part for $type {
            fn pass(given: Option<&Self>, pass: &mut Pass) -> Self {
                pass.bits(given.map(|value| u64::from(*value)), Pass::draw) as Self
            }
        }
    )+};
}
numbers! { u8, u16, u32, u64 }

impl Part for bool {
    fn pass(given: Option<&Self>, pass: &mut Pass) -> Self {
        pass.bits(given.map(|value| u64::from(*value)), |pass| pass.below(2)) == 1
    }
}

impl Part for f32 {
    /// Any bit pattern, with the awkward ones often.
    fn pass(given: Option<&Self>, pass: &mut Pass) -> Self {
        let draw = |pass: &mut Pass| match pass.below(8) {
            0 => u64::from((-0.0_f32).to_bits()),
            1 => 0,
            // A signalling NaN with a payload.
            2 => 0x7F80_0001 | (pass.draw() & 0x803F_FFFF),
            _ => pass.draw(),
        };
        Self::from_bits(pass.bits(given.map(|value| value.to_bits().into()), draw) as u32)
    }
}

macro_rules! by_number {
    ($($type:ty),+) => {$(
        impl Part for $type {
            fn pass(given: Option<&Self>, pass: &mut Pass) -> Self {
                let draw = |pass: &mut Pass| pass.below(Self::ALL.len() as u64);
                Self::ALL[pass.bits(given.map(|value| *value as u64), draw) as usize]
            }
        }
    )+};
}
by_number! { VehicleMode, Landed, GuidanceState, Verdict, AlarmCause, AlarmResponse }

impl<T: Part> Part for Option<T> {
    fn pass(given: Option<&Self>, pass: &mut Pass) -> Self {
        let is_some = bool::pass(given.map(Option::is_some).as_ref(), pass);
        is_some.then(|| T::pass(given.and_then(Option::as_ref), pass))
    }
}

impl<T: Part, const N: usize> Part for [T; N] {
    fn pass(given: Option<&Self>, pass: &mut Pass) -> Self {
        std::array::from_fn(|i| T::pass(given.map(|all| &all[i]), pass))
    }
}

impl<F: Frame> Part for Vector<F> {
    fn pass(given: Option<&Self>, pass: &mut Pass) -> Self {
        let [x, y, z] = Part::pass(given.map(|v| v.to_array()).as_ref(), pass);
        Self::new(x, y, z)
    }
}

impl Part for Reasons {
    fn pass(given: Option<&Self>, pass: &mut Pass) -> Self {
        Self(Part::pass(given.map(|reasons| &reasons.0), pass))
    }
}

macro_rules! parts {
    ($($type:ident { $($field:ident),+ })+) => {$(
        impl Part for $type {
            fn pass(given: Option<&Self>, pass: &mut Pass) -> Self {
                Self { $($field: Part::pass(given.map(|given| &given.$field), pass)),+ }
            }
        }
    )+};
}
parts! {
    StepTiming { step, previous_execution_ns, wake_late_ns, slips }
    FrameHeader {
        stamp_ns, sequence, sensor_id, rows, cols, position_ned_m, attitude, reserved, checksum, tag
    }
    Attitude { w, x, y, z }
    StepReport {
        now_ns, timing, state, reasons, telemetry, goal, goal_relative, action, setpoint, frame_sequence, frame_age_ns,
        frames_refused, judgement, alarm
    }
    VehicleTelemetry { heartbeat, kinematics, attitude, landed, battery_remaining }
    Heartbeat { at_ns, armed, mode, failsafe }
    Kinematics { at_ns, position_ned_m, velocity_ned_m_s }
    AttitudeSample { at_ns, attitude, rates_frd_rad_s }
    Goal { position_ned_m }
    GoalRelative { distance_m, bearing_rad }
    Action { forward_m_s, yaw }
    VelocitySetpoint { velocity_m_s, yaw_rate_rad_s }
    Judgement { verdict, score, image, bearing, distance, told, base, phi }
    Alarm { cause, response }
}

/// Records drawn from a seed.
pub struct Draw(pub u64);

impl Draw {
    /// Fills a record; `step` and `now_ns` are given, all else is drawn.
    pub fn record(&mut self, step: u64, now_ns: u64, record: &mut TickRecord) {
        let mut pass = Pass {
            seed: self.0,
            ..Pass::default()
        };
        let frame = bool::pass(None, &mut pass).then(|| {
            let mut frame = Box::new(DepthFrame::EMPTY);
            frame.header = Part::pass(None, &mut pass);
            frame.depth.fill_with(|| Part::pass(None, &mut pass));
            frame
        });
        let timing = StepTiming {
            step,
            ..Part::pass(None, &mut pass)
        };
        let [received, sent] = std::array::from_fn(|_| {
            let mut datagrams = Datagrams::default();
            for _ in 0..pass.below(20) {
                let length = pass.below(300);
                let bytes: Vec<u8> = (0..length).map(|_| Part::pass(None, &mut pass)).collect();
                assert!(datagrams.push(Part::pass(None, &mut pass), &bytes));
            }
            datagrams
        });
        let report = Part::pass(None, &mut pass);
        record.fill(now_ns, timing, frame.as_deref(), &received, &sent, &report);
        self.0 = pass.seed;
    }
}

/// A record drawn from its step number.
pub fn drawn(step: u64) -> Box<TickRecord> {
    let mut record = Box::default();
    Draw(step).record(step, step * 50_000_000, &mut record);
    record
}

/// Every bit of a record.
pub fn bits(record: &TickRecord) -> Vec<u64> {
    let mut pass = Pass::default();
    Part::pass(Some(&record.now_ns), &mut pass);
    Part::pass(Some(&record.timing), &mut pass);
    Part::pass(Some(&record.frame().map(|frame| frame.header)), &mut pass);
    let pixels = record.frame().into_iter().flat_map(|frame| &frame.depth);
    pass.noted.extend(pixels.map(|pixel| u64::from(pixel.to_bits())));
    for datagrams in [&record.received, &record.sent] {
        pass.noted.push(datagrams.len() as u64);
        for (link, bytes) in datagrams.iter() {
            pass.noted.extend([link.into(), bytes.len() as u64]);
            pass.noted.extend(bytes.iter().map(|byte| u64::from(*byte)));
        }
    }
    Part::pass(Some(&record.report), &mut pass);
    pass.noted
}

/// Some flight information.
pub fn info() -> FlightInfo {
    FlightInfo {
        program: "firmware 1.2.3".to_owned(),
        git_commit: Some("0123abc".to_owned()),
        instance: 3,
        seed: Some(u64::MAX),
        actor_sha256: Some("89ab".to_owned()),
        detector_sha256: Some("cdef".to_owned()),
        detector_threshold: Some(0.1 + 0.2),
        config_toml: "[pilot]\nkind = \"geometric\" # ünïcode\n".to_owned(),
    }
}

/// A configuration that misses nothing.
pub fn lockstep(place: LogPlace) -> RecorderConfig {
    RecorderConfig {
        when_full: WhenFull::Wait,
        slots: 8,
        ..RecorderConfig::new(place, info())
    }
}

/// Records steps, each drawn from its number, 50 ms apart; none is missing.
pub fn recorded(config: RecorderConfig, steps: u64) -> Summary {
    let mut recorder = Recorder::start(config).unwrap();
    for step in 0..steps {
        assert!(recorder.record(|slot| Draw(step).record(step, step * 50_000_000, slot)));
    }
    recorder.finish()
}
