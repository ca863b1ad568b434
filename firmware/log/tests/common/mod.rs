//! Records whose every field is drawn from a seed, NaN and all, and their bits for comparison.
#![allow(dead_code, reason = "each test file uses its part")]

use vigil_log::{FlightInfo, LogPlace, Recorder, RecorderConfig, Summary, TickRecord, WhenFull};
use vigil_types::{
    Action, Alarm, AlarmCause, AlarmResponse, Attitude, AttitudeSample, Datagrams, DepthFrame, Frame, FrameHeader,
    FrdVector, Goal, GoalRelative, GuidanceState, HeadingVector, Heartbeat, Judgement, Kinematics, Landed, NedVector,
    Reasons, StepReport, StepTiming, Vector, VehicleMode, VehicleTelemetry, VelocitySetpoint, Verdict,
};

/// splitmix64.
pub struct Draw(pub u64);

impl Draw {
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    fn below(&mut self, n: u64) -> u64 {
        self.bits() % n
    }

    fn yes(&mut self) -> bool {
        self.below(2) == 1
    }

    /// Any bit pattern, with the awkward ones often.
    fn float(&mut self) -> f32 {
        match self.below(8) {
            0 => -0.0,
            1 => 0.0,
            // A signalling NaN with a payload.
            2 => f32::from_bits(0x7F80_0001 | (self.bits() as u32 & 0x803F_FFFF)),
            _ => f32::from_bits(self.bits() as u32),
        }
    }

    fn maybe<T>(&mut self, make: impl FnOnce(&mut Self) -> T) -> Option<T> {
        self.yes().then(|| make(self))
    }

    fn vector<F: Frame>(&mut self) -> Vector<F> {
        Vector::new(self.float(), self.float(), self.float())
    }

    fn attitude(&mut self) -> Attitude {
        Attitude {
            w: self.float(),
            x: self.float(),
            y: self.float(),
            z: self.float(),
        }
    }

    fn timing(&mut self) -> StepTiming {
        StepTiming {
            step: self.bits(),
            previous_execution_ns: self.bits(),
            wake_late_ns: self.bits(),
            slips: self.bits(),
        }
    }

    fn datagrams(&mut self) -> Datagrams {
        let mut datagrams = Datagrams::default();
        for _ in 0..self.below(20) {
            let length = self.below(300) as usize;
            let bytes: Vec<u8> = (0..length).map(|_| self.bits() as u8).collect();
            assert!(datagrams.push(self.bits() as u8, &bytes));
        }
        datagrams
    }

    fn frame(&mut self) -> Box<DepthFrame> {
        let mut frame = Box::new(DepthFrame::EMPTY);
        frame.header = FrameHeader {
            stamp_ns: self.bits(),
            sequence: self.bits(),
            sensor_id: self.bits() as u32,
            rows: self.bits() as u16,
            cols: self.bits() as u16,
            position_ned_m: self.vector(),
            attitude: self.attitude(),
            reserved: self.bits() as u32,
            checksum: self.bits(),
            tag: std::array::from_fn(|_| self.bits() as u8),
        };
        for value in &mut frame.depth {
            *value = self.float();
        }
        frame
    }

    fn telemetry(&mut self) -> VehicleTelemetry {
        VehicleTelemetry {
            heartbeat: self.maybe(|d| Heartbeat {
                at_ns: d.bits(),
                armed: d.yes(),
                mode: VehicleMode::ALL[d.below(8) as usize],
                failsafe: d.yes(),
            }),
            kinematics: self.maybe(|d| Kinematics::new(d.bits(), d.vector(), d.vector())),
            attitude: self.maybe(|d| AttitudeSample::new(d.bits(), d.attitude(), d.vector())),
            landed: Landed::ALL[self.below(5) as usize],
            battery_remaining: self.maybe(Self::float),
        }
    }

    fn report(&mut self) -> StepReport {
        StepReport {
            now_ns: self.bits(),
            timing: self.timing(),
            state: GuidanceState::ALL[self.below(6) as usize],
            reasons: Reasons(self.bits()),
            telemetry: self.telemetry(),
            goal: self.maybe(|d| Goal {
                position_ned_m: d.vector(),
            }),
            goal_relative: self.maybe(|d| GoalRelative::new(d.float(), d.float())),
            action: self.maybe(|d| Action::new(d.float(), d.float())),
            setpoint: self.maybe(|d| VelocitySetpoint {
                velocity_m_s: d.vector(),
                yaw_rate_rad_s: d.float(),
            }),
            frame_sequence: self.maybe(Self::bits),
            frame_age_ns: self.maybe(Self::bits),
            frames_refused: self.bits(),
            judgement: self.maybe(|d| Judgement {
                verdict: Verdict::ALL[d.below(3) as usize],
                score: d.maybe(Self::float),
                image: d.float(),
                bearing: d.float(),
                distance: d.float(),
                told: d.float(),
                base: d.float(),
                phi: std::array::from_fn(|_| d.float()),
            }),
            alarm: self.maybe(|d| Alarm {
                cause: AlarmCause::ALL[d.below(5) as usize],
                response: AlarmResponse::ALL[d.below(3) as usize],
            }),
        }
    }

    /// Fills a record; `step` and `now_ns` are given, all else is drawn.
    pub fn record(&mut self, step: u64, now_ns: u64, record: &mut TickRecord) {
        let frame = self.maybe(Self::frame);
        let timing = StepTiming { step, ..self.timing() };
        let (received, sent, report) = (self.datagrams(), self.datagrams(), self.report());
        record.fill(now_ns, timing, frame.as_deref(), &received, &sent, &report);
    }
}

/// A record drawn from its step number.
pub fn drawn(step: u64) -> Box<TickRecord> {
    let mut record = Box::default();
    Draw(step).record(step, step * 50_000_000, &mut record);
    record
}

/// Every bit of a record, written down field by field and apart from the log's own encoding.
pub fn bits(record: &TickRecord) -> Vec<u64> {
    let mut all = Bits(Vec::new());
    all.whole(&[record.now_ns]);
    all.timing(record.timing);
    match record.frame() {
        None => all.whole(&[0]),
        Some(DepthFrame { header: h, depth }) => {
            all.whole(&[
                1,
                h.stamp_ns,
                h.sequence,
                h.sensor_id.into(),
                h.rows.into(),
                h.cols.into(),
            ]);
            all.floats(&h.position_ned_m.to_array());
            all.attitude(h.attitude);
            all.whole(&[h.reserved.into(), h.checksum]);
            all.0.extend(h.tag.map(u64::from));
            all.floats(depth);
        }
    }
    for datagrams in [&record.received, &record.sent] {
        all.whole(&[datagrams.len() as u64]);
        for (link, bytes) in datagrams.iter() {
            all.whole(&[link.into(), bytes.len() as u64]);
            all.0.extend(bytes.iter().map(|b| u64::from(*b)));
        }
    }
    let r = &record.report;
    all.whole(&[r.now_ns, r.state as u64, r.reasons.0, r.frames_refused]);
    all.timing(r.timing);
    all.option(r.frame_sequence, |all, v| all.whole(&[v]));
    all.option(r.frame_age_ns, |all, v| all.whole(&[v]));
    all.option(r.goal, |all, v| all.floats(&v.position_ned_m.to_array()));
    all.option(r.goal_relative, |all, v| all.floats(&[v.distance_m, v.bearing_rad]));
    all.option(r.action, |all, v| all.floats(&[v.forward_m_s, v.yaw]));
    all.option(r.setpoint, |all, v| {
        let velocity: HeadingVector = v.velocity_m_s;
        all.floats(&velocity.to_array());
        all.floats(&[v.yaw_rate_rad_s]);
    });
    all.option(r.judgement, |all, v| {
        all.whole(&[v.verdict as u64]);
        all.option(v.score, |all, score| all.floats(&[score]));
        all.floats(&[v.image, v.bearing, v.distance, v.told, v.base]);
        all.floats(&v.phi);
    });
    all.option(r.alarm, |all, v| all.whole(&[v.cause as u64, v.response as u64]));
    let t = &r.telemetry;
    all.option(t.heartbeat, |all, v| {
        all.whole(&[v.at_ns, v.armed.into(), v.mode as u64, v.failsafe.into()]);
    });
    all.option(t.kinematics, |all, v| {
        let (position, velocity): (NedVector, NedVector) = (v.position_ned_m, v.velocity_ned_m_s);
        all.whole(&[v.at_ns]);
        all.floats(&[position.to_array(), velocity.to_array()].concat());
    });
    all.option(t.attitude, |all, v| {
        let rates: FrdVector = v.rates_frd_rad_s;
        all.whole(&[v.at_ns]);
        all.attitude(v.attitude);
        all.floats(&rates.to_array());
    });
    all.whole(&[t.landed as u64]);
    all.option(t.battery_remaining, |all, v| all.floats(&[v]));
    all.0
}

struct Bits(Vec<u64>);

impl Bits {
    fn whole(&mut self, values: &[u64]) {
        self.0.extend(values);
    }

    fn floats(&mut self, values: &[f32]) {
        self.0.extend(values.iter().map(|v| u64::from(v.to_bits())));
    }

    fn attitude(&mut self, q: Attitude) {
        self.floats(&[q.w, q.x, q.y, q.z]);
    }

    fn timing(&mut self, t: StepTiming) {
        self.whole(&[t.step, t.previous_execution_ns, t.wake_late_ns, t.slips]);
    }

    fn option<T>(&mut self, value: Option<T>, put: impl FnOnce(&mut Self, T)) {
        self.whole(&[value.is_some().into()]);
        if let Some(value) = value {
            put(self, value);
        }
    }
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
