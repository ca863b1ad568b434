//! Between the loop's data and the messages on disk, bit for bit in both directions.

use crate::proto;
use crate::{TickRecord, proto::Tick};
use vigil_types::{
    Action, Alarm, AlarmCause, AlarmResponse, Attitude, AttitudeSample, Datagrams, FRAME_TAG_BYTES, Frame, FrameHeader,
    Goal, GoalRelative, GuidanceState, Heartbeat, Judgement, Kinematics, Landed, Reasons, StepReport, StepTiming,
    Vector, VehicleMode, VehicleTelemetry, VelocitySetpoint, Verdict,
};

/// Why a message that decodes as protobuf is no step all the same: which field, and what is wrong with it.
type Defect = String;

/// The message of a record; the frame's pixels are not in it.
pub(crate) fn to_wire(record: &TickRecord) -> Tick {
    Tick {
        now_ns: record.now_ns,
        timing: record.timing.to(),
        frame: record.frame().map(|f| f.header.message()),
        received: datagrams_to_proto(&record.received),
        sent: datagrams_to_proto(&record.sent),
        report: record.report.to(),
        dropped_before: record.dropped_before,
    }
}

/// Fills `record` from its message. Returns whether the step had a frame: its header is then in place, its pixels are
/// the caller's to fill.
pub(crate) fn from_wire(tick: &Tick, record: &mut TickRecord) -> Result<bool, Defect> {
    record.now_ns = tick.now_ns;
    record.timing = Part::from(&tick.timing, "timing")?;
    record.dropped_before = tick.dropped_before;
    record.report = Part::from(&tick.report, "report")?;
    datagrams_from_proto(&tick.received, &mut record.received, "received")?;
    datagrams_from_proto(&tick.sent, &mut record.sent, "sent")?;
    let header = tick.frame.as_ref().map(FrameHeader::of).transpose()?;
    record.frame_slot(header.is_some()).header = header.unwrap_or_default();
    Ok(header.is_some())
}

fn need<T>(value: Option<T>, field: &'static str) -> Result<T, Defect> {
    value.ok_or_else(|| format!("field `{field}` is missing"))
}

/// A value of the loop's whose field in a message is an `M`.
trait Part<M>: Sized {
    fn to(self) -> M;
    fn from(on_disk: &M, field: &'static str) -> Result<Self, Defect>;
}

/// A struct of the loop's that is a message of its own.
trait Record: Sized {
    type Message;
    fn message(self) -> Self::Message;
    fn of(message: &Self::Message) -> Result<Self, Defect>;
}

impl<T: Record> Part<Option<T::Message>> for Option<T> {
    fn to(self) -> Option<T::Message> {
        self.map(T::message)
    }

    fn from(on_disk: &Option<T::Message>, _: &'static str) -> Result<Self, Defect> {
        on_disk.as_ref().map(T::of).transpose()
    }
}

macro_rules! as_it_is {
    ($($type:ty),+) => {$(
        impl Part<$type> for $type {
            fn to(self) -> $type {
                self
            }

            fn from(on_disk: &$type, _: &'static str) -> Result<Self, Defect> {
                Ok(*on_disk)
            }
        }
    )+};
}
as_it_is! { bool, u32, u64, Option<f32>, Option<u64> }

/// Values by their numbers.
macro_rules! by_number {
    ($($type:ty),+) => {$(
        impl Part<u32> for $type {
            fn to(self) -> u32 {
                self as u32
            }

            fn from(on_disk: &u32, field: &'static str) -> Result<Self, Defect> {
                let value = usize::try_from(*on_disk).ok().and_then(|i| Self::ALL.get(i).copied());
                value.ok_or_else(|| impossible(field, *on_disk))
            }
        }
    )+};
}
by_number! { VehicleMode, Landed, GuidanceState, Verdict, AlarmCause, AlarmResponse }

impl Part<u32> for u16 {
    fn to(self) -> u32 {
        self.into()
    }

    fn from(on_disk: &u32, field: &'static str) -> Result<Self, Defect> {
        small(*on_disk, field)
    }
}

fn small<T: TryFrom<u32>>(value: u32, field: &'static str) -> Result<T, Defect> {
    T::try_from(value).map_err(|_| impossible(field, value))
}

fn impossible(field: &str, value: u32) -> Defect {
    format!("field `{field}` has the impossible value {value}")
}

impl Part<Option<f32>> for f32 {
    fn to(self) -> Option<f32> {
        Some(self)
    }

    fn from(on_disk: &Option<f32>, field: &'static str) -> Result<Self, Defect> {
        need(*on_disk, field)
    }
}

impl<T: Record> Part<Option<T::Message>> for T {
    fn to(self) -> Option<T::Message> {
        Some(self.message())
    }

    fn from(on_disk: &Option<T::Message>, field: &'static str) -> Result<Self, Defect> {
        Self::of(need(on_disk.as_ref(), field)?)
    }
}

impl Part<Option<proto::Xyz>> for Option<Goal> {
    fn to(self) -> Option<proto::Xyz> {
        self.and_then(|goal| goal.position_ned_m.to())
    }

    fn from(on_disk: &Option<proto::Xyz>, field: &'static str) -> Result<Self, Defect> {
        let position = on_disk.map(|_| Part::from(on_disk, field)).transpose()?;
        Ok(position.map(|position_ned_m| Goal { position_ned_m }))
    }
}

impl<F: Frame> Part<Option<proto::Xyz>> for Vector<F> {
    fn to(self) -> Option<proto::Xyz> {
        Some(proto::Xyz {
            x: Some(self.x),
            y: Some(self.y),
            z: Some(self.z),
        })
    }

    fn from(on_disk: &Option<proto::Xyz>, field: &'static str) -> Result<Self, Defect> {
        let v = need(on_disk.as_ref(), field)?;
        Ok(Self::new(need(v.x, field)?, need(v.y, field)?, need(v.z, field)?))
    }
}

impl Part<Option<proto::Wxyz>> for Attitude {
    fn to(self) -> Option<proto::Wxyz> {
        Some(proto::Wxyz {
            w: Some(self.w),
            x: Some(self.x),
            y: Some(self.y),
            z: Some(self.z),
        })
    }

    fn from(on_disk: &Option<proto::Wxyz>, field: &'static str) -> Result<Self, Defect> {
        let q = need(on_disk.as_ref(), field)?;
        Ok(Self {
            w: need(q.w, field)?,
            x: need(q.x, field)?,
            y: need(q.y, field)?,
            z: need(q.z, field)?,
        })
    }
}

impl Part<Vec<u8>> for [u8; FRAME_TAG_BYTES] {
    fn to(self) -> Vec<u8> {
        // Most frames have none.
        match self == [0; FRAME_TAG_BYTES] {
            true => Vec::new(),
            false => self.to_vec(),
        }
    }

    fn from(on_disk: &Vec<u8>, _: &'static str) -> Result<Self, Defect> {
        match on_disk.as_slice() {
            [] => Ok([0; FRAME_TAG_BYTES]),
            tag => tag
                .try_into()
                .map_err(|_| impossible("frame.tag, bytes", tag.len() as u32)),
        }
    }
}

impl<const N: usize> Part<Vec<f32>> for [f32; N] {
    fn to(self) -> Vec<f32> {
        self.to_vec()
    }

    fn from(on_disk: &Vec<f32>, field: &'static str) -> Result<Self, Defect> {
        need(on_disk.as_slice().try_into().ok(), field)
    }
}

/// Structs with the messages that hold their fields, under the same names or others (`as`), what an absent one is (`or`), and where these
/// messages lie. Each is taken apart by name, so that a field added to the loop's data fails to compile here until the log records it.
macro_rules! records {
    ($type:ident = $message:ident in $at:literal {
        $($field:ident as $on_disk:ident $(or $absent:literal)?),+ $(; $bits:ident as [$first:ident, $second:ident])?
    }) => {
        impl Record for $type {
            type Message = proto::$message;

            fn message(self) -> proto::$message {
                let Self { $($field,)+ $($bits)? } = self;
                $(let [$first, $second] = $bits.words();)?
                proto::$message { $($on_disk: $field.to(),)+ $($first, $second)? }
            }

            fn of(message: &proto::$message) -> Result<Self, Defect> {
                Ok(Self {
                    $($field: Part::from(&message.$on_disk$(.or(Some($absent)))?, concat!($at, stringify!($on_disk)))?,)+
                    $($bits: Reasons::from_words([message.$first, message.$second]))?
                })
            }
        }
    };
    ($($type:ident = $message:ident in $at:literal { $($field:ident $(or $absent:literal)?),+ })+) => {
        $(records! { $type = $message in $at { $($field as $field $(or $absent)?),+ } })+
    };
}

records! {
    StepTiming = Timing in "timing." { step, previous_execution_ns, wake_late_ns, slips }
    FrameHeader = Frame in "frame." {
        stamp_ns, sequence, sensor_id, rows, cols, position_ned_m, attitude, reserved, checksum, tag
    }
    GoalRelative = GoalRelative in "report.goal_relative." { distance_m, bearing_rad }
    Action = Action in "report.action." { forward_m_s, yaw }
    Alarm = Alarm in "report.alarm." { cause, response }
    // Logs of actors that were given the goal alone do not have what they observed of themselves.
    Judgement = Judgement in "report.judgement." { verdict, score, image, bearing, distance, told or 0.0, base, phi }
    VehicleTelemetry = Telemetry in "report.telemetry." { heartbeat, kinematics, attitude, landed, battery_remaining }
    Heartbeat = Heartbeat in "report.telemetry.heartbeat." { at_ns, armed, mode, failsafe }
    Kinematics = Kinematics in "report.telemetry.kinematics." { at_ns, position_ned_m, velocity_ned_m_s }
    AttitudeSample = AttitudeSample in "report.telemetry.attitude." { at_ns, attitude, rates_frd_rad_s }
}
records! {
    StepReport = Report in "report." {
        now_ns as now_ns, timing as timing, state as state, telemetry as telemetry,
        goal as goal_position_ned_m, goal_relative as goal_relative, action as action, setpoint as setpoint,
        frame_sequence as frame_sequence, frame_age_ns as frame_age_ns, frames_refused as frames_refused,
        judgement as judgement, alarm as alarm;
        reasons as [reasons, further_reasons]
    }
}
records! {
    VelocitySetpoint = Setpoint in "report.setpoint." {
        velocity_m_s as velocity_heading_m_s, yaw_rate_rad_s as yaw_rate_rad_s
    }
}

fn datagrams_to_proto(datagrams: &Datagrams) -> Vec<proto::Datagram> {
    let message = |(link, bytes): (u8, &[u8])| proto::Datagram {
        link: link.into(),
        data: bytes.to_vec(),
    };
    datagrams.iter().map(message).collect()
}

fn datagrams_from_proto(from: &[proto::Datagram], to: &mut Datagrams, field: &'static str) -> Result<(), Defect> {
    to.clear();
    for datagram in from {
        if !to.push(small(datagram.link, field)?, &datagram.data) {
            return Err(format!("field `{field}` holds more datagrams than a step can"));
        }
    }
    Ok(())
}
