//! Between the loop's data and the messages on disk, bit for bit in both directions.
//!
//! Towards disk every struct is taken apart by name, so that a field added to the loop's data fails to compile here
//! until the log records it.

use crate::proto;
use crate::{TickRecord, proto::Tick};
use vigil_types::{
    Action, Alarm, AlarmCause, AlarmResponse, Attitude, AttitudeSample, Datagrams, FRAME_TAG_BYTES, FrameHeader, Goal,
    GoalRelative, GuidanceState, Heartbeat, Judgement, Kinematics, Landed, Reasons, StepReport, StepTiming, Vector,
    VehicleMode, VehicleTelemetry, VelocitySetpoint, Verdict,
};

/// A message that decodes as protobuf and yet is no step: which field, and what is wrong with it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum RecordDefect {
    /// A field that every record has is not there.
    #[error("field `{0}` is missing")]
    Missing(&'static str),
    /// A number is outside what its field can hold.
    #[error("field `{field}` has the impossible value {value}")]
    Impossible {
        /// Name of the field.
        field: &'static str,
        /// What was found.
        value: u32,
    },
    /// More datagrams than a step can hold.
    #[error("field `{0}` holds more datagrams than a step can")]
    TooManyDatagrams(&'static str),
}

const MODES: [VehicleMode; 8] = [
    VehicleMode::Unknown,
    VehicleMode::External,
    VehicleMode::Hold,
    VehicleMode::Takeoff,
    VehicleMode::Land,
    VehicleMode::Return,
    VehicleMode::Mission,
    VehicleMode::Other,
];

const LANDED: [Landed; 5] = [
    Landed::Unknown,
    Landed::OnGround,
    Landed::TakingOff,
    Landed::InAir,
    Landed::Landing,
];

const fn mode_code(mode: VehicleMode) -> u32 {
    match mode {
        VehicleMode::Unknown => 0,
        VehicleMode::External => 1,
        VehicleMode::Hold => 2,
        VehicleMode::Takeoff => 3,
        VehicleMode::Land => 4,
        VehicleMode::Return => 5,
        VehicleMode::Mission => 6,
        VehicleMode::Other => 7,
    }
}

const fn landed_code(landed: Landed) -> u32 {
    match landed {
        Landed::Unknown => 0,
        Landed::OnGround => 1,
        Landed::TakingOff => 2,
        Landed::InAir => 3,
        Landed::Landing => 4,
    }
}

/// The message of a record; the frame's pixels are not in it.
pub(crate) fn to_wire(record: &TickRecord) -> Tick {
    Tick {
        now_ns: record.now_ns,
        timing: Some(timing_to_proto(record.timing)),
        frame: record.frame().map(|f| header_to_proto(&f.header)),
        received: datagrams_to_proto(&record.received),
        sent: datagrams_to_proto(&record.sent),
        report: Some(report_to_proto(&record.report)),
        dropped_before: record.dropped_before,
    }
}

/// Fills `record` from its message. Returns whether the step had a frame: its header is then in place, its pixels are
/// the caller's to fill.
pub(crate) fn from_wire(tick: &Tick, record: &mut TickRecord) -> Result<bool, RecordDefect> {
    record.now_ns = tick.now_ns;
    record.timing = timing_from_proto(tick.timing.as_ref(), "timing")?;
    record.dropped_before = tick.dropped_before;
    record.report = report_from_proto(need(tick.report.as_ref(), "report")?)?;
    datagrams_from_proto(&tick.received, &mut record.received, "received")?;
    datagrams_from_proto(&tick.sent, &mut record.sent, "sent")?;
    let header = tick.frame.as_ref().map(header_from_proto).transpose()?;
    record.frame_slot(header.is_some()).header = header.unwrap_or_default();
    Ok(header.is_some())
}

fn need<T>(value: Option<T>, field: &'static str) -> Result<T, RecordDefect> {
    value.ok_or(RecordDefect::Missing(field))
}

fn small<T: TryFrom<u32>>(value: u32, field: &'static str) -> Result<T, RecordDefect> {
    T::try_from(value).map_err(|_| RecordDefect::Impossible { field, value })
}

fn code<T: Copy>(table: &[T], value: u32, field: &'static str) -> Result<T, RecordDefect> {
    usize::try_from(value)
        .ok()
        .and_then(|i| table.get(i).copied())
        .ok_or(RecordDefect::Impossible { field, value })
}

fn timing_to_proto(timing: StepTiming) -> proto::Timing {
    let StepTiming {
        step,
        previous_execution_ns,
        wake_late_ns,
        slips,
    } = timing;
    proto::Timing {
        step,
        previous_execution_ns,
        wake_late_ns,
        slips,
    }
}

fn timing_from_proto(timing: Option<&proto::Timing>, field: &'static str) -> Result<StepTiming, RecordDefect> {
    let t = need(timing, field)?;
    Ok(StepTiming {
        step: t.step,
        previous_execution_ns: t.previous_execution_ns,
        wake_late_ns: t.wake_late_ns,
        slips: t.slips,
    })
}

fn header_to_proto(header: &FrameHeader) -> proto::Frame {
    let FrameHeader {
        stamp_ns,
        sequence,
        sensor_id,
        rows,
        cols,
        position_ned_m,
        attitude,
        reserved,
        checksum,
        tag,
    } = *header;
    proto::Frame {
        stamp_ns,
        sequence,
        sensor_id,
        rows: rows.into(),
        cols: cols.into(),
        position_ned_m: Some(xyz_to_proto(position_ned_m)),
        attitude: Some(attitude_to_proto(attitude)),
        reserved,
        checksum,
        // Most frames have none.
        tag: if tag == [0; FRAME_TAG_BYTES] {
            Vec::new()
        } else {
            tag.to_vec()
        },
    }
}

fn header_from_proto(frame: &proto::Frame) -> Result<FrameHeader, RecordDefect> {
    Ok(FrameHeader {
        stamp_ns: frame.stamp_ns,
        sequence: frame.sequence,
        sensor_id: frame.sensor_id,
        rows: small(frame.rows, "frame.rows")?,
        cols: small(frame.cols, "frame.cols")?,
        position_ned_m: xyz_from_proto(frame.position_ned_m.as_ref(), "frame.position_ned_m")?,
        attitude: attitude_from_proto(frame.attitude.as_ref(), "frame.attitude")?,
        reserved: frame.reserved,
        checksum: frame.checksum,
        tag: match frame.tag.as_slice() {
            [] => [0; FRAME_TAG_BYTES],
            tag => tag.try_into().map_err(|_| RecordDefect::Impossible {
                field: "frame.tag, bytes",
                value: tag.len() as u32,
            })?,
        },
    })
}

fn datagrams_to_proto(datagrams: &Datagrams) -> Vec<proto::Datagram> {
    datagrams
        .iter()
        .map(|(link, bytes)| proto::Datagram {
            link: link.into(),
            data: bytes.to_vec(),
        })
        .collect()
}

fn datagrams_from_proto(from: &[proto::Datagram], to: &mut Datagrams, field: &'static str) -> Result<(), RecordDefect> {
    to.clear();
    for datagram in from {
        if !to.push(small(datagram.link, field)?, &datagram.data) {
            return Err(RecordDefect::TooManyDatagrams(field));
        }
    }
    Ok(())
}

fn report_to_proto(report: &StepReport) -> proto::Report {
    let StepReport {
        now_ns,
        timing,
        state,
        reasons,
        telemetry,
        goal,
        goal_relative,
        action,
        judgement,
        alarm,
        setpoint,
        frame_sequence,
        frame_age_ns,
        frames_refused,
    } = *report;
    let [first_reasons, further_reasons] = reasons.words();
    proto::Report {
        now_ns,
        timing: Some(timing_to_proto(timing)),
        state: state as u32,
        reasons: first_reasons,
        further_reasons,
        telemetry: Some(telemetry_to_proto(&telemetry)),
        goal_position_ned_m: goal.map(|Goal { position_ned_m }| xyz_to_proto(position_ned_m)),
        goal_relative: goal_relative.map(
            |GoalRelative {
                 distance_m,
                 bearing_rad,
             }| proto::GoalRelative {
                distance_m: Some(distance_m),
                bearing_rad: Some(bearing_rad),
            },
        ),
        action: action.map(|Action { forward_m_s, yaw }| proto::Action {
            forward_m_s: Some(forward_m_s),
            yaw: Some(yaw),
        }),
        setpoint: setpoint.map(
            |VelocitySetpoint {
                 velocity_m_s,
                 yaw_rate_rad_s,
             }| proto::Setpoint {
                velocity_heading_m_s: Some(xyz_to_proto(velocity_m_s)),
                yaw_rate_rad_s: Some(yaw_rate_rad_s),
            },
        ),
        frame_sequence,
        frame_age_ns,
        frames_refused,
        judgement: judgement.as_ref().map(judgement_to_proto),
        alarm: alarm.map(|Alarm { cause, response }| proto::Alarm {
            cause: cause as u32,
            response: response as u32,
        }),
    }
}

fn report_from_proto(report: &proto::Report) -> Result<StepReport, RecordDefect> {
    let goal = report.goal_position_ned_m.as_ref();
    Ok(StepReport {
        now_ns: report.now_ns,
        timing: timing_from_proto(report.timing.as_ref(), "report.timing")?,
        state: code(&GuidanceState::ALL, report.state, "report.state")?,
        reasons: Reasons::from_words([report.reasons, report.further_reasons]),
        telemetry: telemetry_from_proto(need(report.telemetry.as_ref(), "report.telemetry")?)?,
        goal: goal
            .map(|_| xyz_from_proto(goal, "report.goal_position_ned_m").map(|position_ned_m| Goal { position_ned_m }))
            .transpose()?,
        goal_relative: report
            .goal_relative
            .as_ref()
            .map(|g| {
                Ok(GoalRelative {
                    distance_m: need(g.distance_m, "report.goal_relative.distance_m")?,
                    bearing_rad: need(g.bearing_rad, "report.goal_relative.bearing_rad")?,
                })
            })
            .transpose()?,
        action: report
            .action
            .as_ref()
            .map(|a| {
                Ok(Action {
                    forward_m_s: need(a.forward_m_s, "report.action.forward_m_s")?,
                    yaw: need(a.yaw, "report.action.yaw")?,
                })
            })
            .transpose()?,
        setpoint: report
            .setpoint
            .as_ref()
            .map(|s| {
                Ok(VelocitySetpoint {
                    velocity_m_s: xyz_from_proto(
                        s.velocity_heading_m_s.as_ref(),
                        "report.setpoint.velocity_heading_m_s",
                    )?,
                    yaw_rate_rad_s: need(s.yaw_rate_rad_s, "report.setpoint.yaw_rate_rad_s")?,
                })
            })
            .transpose()?,
        frame_sequence: report.frame_sequence,
        frame_age_ns: report.frame_age_ns,
        frames_refused: report.frames_refused,
        judgement: report.judgement.as_ref().map(judgement_from_proto).transpose()?,
        alarm: report
            .alarm
            .as_ref()
            .map(|a| {
                Ok(Alarm {
                    cause: code(&AlarmCause::ALL, a.cause, "report.alarm.cause")?,
                    response: code(&AlarmResponse::ALL, a.response, "report.alarm.response")?,
                })
            })
            .transpose()?,
    })
}

fn judgement_to_proto(judgement: &Judgement) -> proto::Judgement {
    let Judgement {
        verdict,
        score,
        image,
        bearing,
        distance,
        told,
        base,
        phi,
    } = judgement;
    proto::Judgement {
        verdict: *verdict as u32,
        score: *score,
        image: Some(*image),
        bearing: Some(*bearing),
        distance: Some(*distance),
        told: Some(*told),
        base: Some(*base),
        phi: phi.to_vec(),
    }
}

fn judgement_from_proto(judgement: &proto::Judgement) -> Result<Judgement, RecordDefect> {
    Ok(Judgement {
        verdict: code(&Verdict::ALL, judgement.verdict, "report.judgement.verdict")?,
        score: judgement.score,
        image: need(judgement.image, "report.judgement.image")?,
        bearing: need(judgement.bearing, "report.judgement.bearing")?,
        distance: need(judgement.distance, "report.judgement.distance")?,
        // Logs of actors that were given the goal alone do not have it.
        told: judgement.told.unwrap_or(0.0),
        base: need(judgement.base, "report.judgement.base")?,
        phi: judgement
            .phi
            .as_slice()
            .try_into()
            .map_err(|_| RecordDefect::Missing("report.judgement.phi"))?,
    })
}

fn telemetry_to_proto(telemetry: &VehicleTelemetry) -> proto::Telemetry {
    let VehicleTelemetry {
        heartbeat,
        kinematics,
        attitude,
        landed,
        battery_remaining,
    } = *telemetry;
    proto::Telemetry {
        heartbeat: heartbeat.map(
            |Heartbeat {
                 at_ns,
                 armed,
                 mode,
                 failsafe,
             }| proto::Heartbeat {
                at_ns,
                armed,
                mode: mode_code(mode),
                failsafe,
            },
        ),
        kinematics: kinematics.map(
            |Kinematics {
                 at_ns,
                 position_ned_m,
                 velocity_ned_m_s,
             }| proto::Kinematics {
                at_ns,
                position_ned_m: Some(xyz_to_proto(position_ned_m)),
                velocity_ned_m_s: Some(xyz_to_proto(velocity_ned_m_s)),
            },
        ),
        attitude: attitude.map(
            |AttitudeSample {
                 at_ns,
                 attitude,
                 rates_frd_rad_s,
             }| proto::AttitudeSample {
                at_ns,
                attitude: Some(attitude_to_proto(attitude)),
                rates_frd_rad_s: Some(xyz_to_proto(rates_frd_rad_s)),
            },
        ),
        landed: landed_code(landed),
        battery_remaining,
    }
}

fn telemetry_from_proto(telemetry: &proto::Telemetry) -> Result<VehicleTelemetry, RecordDefect> {
    Ok(VehicleTelemetry {
        heartbeat: telemetry
            .heartbeat
            .as_ref()
            .map(|h| {
                Ok(Heartbeat {
                    at_ns: h.at_ns,
                    armed: h.armed,
                    mode: code(&MODES, h.mode, "report.telemetry.heartbeat.mode")?,
                    failsafe: h.failsafe,
                })
            })
            .transpose()?,
        kinematics: telemetry
            .kinematics
            .as_ref()
            .map(|k| {
                Ok(Kinematics {
                    at_ns: k.at_ns,
                    position_ned_m: xyz_from_proto(
                        k.position_ned_m.as_ref(),
                        "report.telemetry.kinematics.position_ned_m",
                    )?,
                    velocity_ned_m_s: xyz_from_proto(
                        k.velocity_ned_m_s.as_ref(),
                        "report.telemetry.kinematics.velocity_ned_m_s",
                    )?,
                })
            })
            .transpose()?,
        attitude: telemetry
            .attitude
            .as_ref()
            .map(|a| {
                Ok(AttitudeSample {
                    at_ns: a.at_ns,
                    attitude: attitude_from_proto(a.attitude.as_ref(), "report.telemetry.attitude.attitude")?,
                    rates_frd_rad_s: xyz_from_proto(
                        a.rates_frd_rad_s.as_ref(),
                        "report.telemetry.attitude.rates_frd_rad_s",
                    )?,
                })
            })
            .transpose()?,
        landed: code(&LANDED, telemetry.landed, "report.telemetry.landed")?,
        battery_remaining: telemetry.battery_remaining,
    })
}

fn xyz_to_proto<F: vigil_types::Frame>(v: Vector<F>) -> proto::Xyz {
    proto::Xyz {
        x: Some(v.x),
        y: Some(v.y),
        z: Some(v.z),
    }
}

fn xyz_from_proto<F: vigil_types::Frame>(
    v: Option<&proto::Xyz>,
    field: &'static str,
) -> Result<Vector<F>, RecordDefect> {
    let v = need(v, field)?;
    Ok(Vector::new(need(v.x, field)?, need(v.y, field)?, need(v.z, field)?))
}

fn attitude_to_proto(q: Attitude) -> proto::Wxyz {
    proto::Wxyz {
        w: Some(q.w),
        x: Some(q.x),
        y: Some(q.y),
        z: Some(q.z),
    }
}

fn attitude_from_proto(q: Option<&proto::Wxyz>, field: &'static str) -> Result<Attitude, RecordDefect> {
    let q = need(q, field)?;
    Ok(Attitude {
        w: need(q.w, field)?,
        x: need(q.x, field)?,
        y: need(q.y, field)?,
        z: need(q.z, field)?,
    })
}
