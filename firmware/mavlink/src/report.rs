//! What the guidance computer says of itself: HEARTBEAT, NAMED_VALUE_FLOAT, STATUSTEXT, and its setpoints.

use crate::autopilot::{Flavour, command_number};
use crate::operator::why as why_refused;
use crate::services::handover::Trouble;
use crate::services::setpoint_timeout::Finding;
use crate::services::streams::Slow;
use crate::status_text::StatusText;
use crate::vehicle::Vehicle;
use core::fmt::Write;
use mavlink::dialects::common::{
    HEARTBEAT_DATA, MavAutopilot, MavFrame, MavMessage, MavModeFlag, MavSeverity, MavState, MavType,
    NAMED_VALUE_FLOAT_DATA, PositionTargetTypemask, SET_POSITION_TARGET_LOCAL_NED_DATA,
};
use vigil_types::{
    Alarm, AlarmResponse, GuardNotice, GuidanceState, Nanos, NedVector, Reason, Reasons, StepReport, StopCause,
    VelocitySetpoint,
};

/// MAVLink's time since boot. Wraps after 49 days, as the protocol's field does.
pub(crate) fn time_boot_ms(now_ns: Nanos) -> u32 {
    (now_ns / 1_000_000) as u32
}

/// A companion's heartbeat: base_mode 0 and no autopilot, so that nobody takes it for the vehicle's (MAVLINK.md).
pub(crate) fn heartbeat(state: MavState) -> MavMessage {
    MavMessage::HEARTBEAT(HEARTBEAT_DATA {
        custom_mode: 0,
        mavtype: MavType::MAV_TYPE_ONBOARD_CONTROLLER,
        autopilot: MavAutopilot::MAV_AUTOPILOT_INVALID,
        base_mode: MavModeFlag::empty(),
        system_status: state,
        mavlink_version: 3,
    })
}

/// Holding at the goal or by an operator's wish is in order; any other hold is not.
fn is_faulty_hold(state: GuidanceState, reasons: Reasons) -> bool {
    let in_order = Reasons::of(Reason::GoalReached).union(Reasons::of(Reason::Operator));
    state == GuidanceState::Hold && !Reasons(reasons.0 & !in_order.0).is_empty()
}

/// Health as MAV_STATE.
pub(crate) fn mav_state(state: GuidanceState, reasons: Reasons) -> MavState {
    match state {
        GuidanceState::Standby => MavState::MAV_STATE_BOOT,
        GuidanceState::Ready => MavState::MAV_STATE_STANDBY,
        GuidanceState::Hold if is_faulty_hold(state, reasons) => MavState::MAV_STATE_CRITICAL,
        GuidanceState::Guided if reasons.contains(Reason::Recovering) => MavState::MAV_STATE_CRITICAL,
        GuidanceState::Engaging | GuidanceState::Guided | GuidanceState::Hold | GuidanceState::Land => {
            MavState::MAV_STATE_ACTIVE
        }
    }
}

/// SET_POSITION_TARGET_LOCAL_NED in frame 8 with mask 0x5C7: velocity and yaw rate.
pub(crate) fn setpoint(now_ns: Nanos, system: u8, setpoint: &VelocitySetpoint) -> MavMessage {
    let v = setpoint.velocity_m_s;
    MavMessage::SET_POSITION_TARGET_LOCAL_NED(SET_POSITION_TARGET_LOCAL_NED_DATA {
        time_boot_ms: time_boot_ms(now_ns),
        vx: v.x,
        vy: v.y,
        vz: v.z,
        yaw_rate: setpoint.yaw_rate_rad_s,
        type_mask: PositionTargetTypemask::from_bits_retain(0x05C7),
        target_system: system,
        target_component: 1,
        // Deprecated in the protocol for BODY_FRD, which neither PX4 nor ArduPilot takes here.
        #[allow(deprecated)]
        coordinate_frame: MavFrame::MAV_FRAME_BODY_NED,
        ..SET_POSITION_TARGET_LOCAL_NED_DATA::DEFAULT
    })
}

fn named(now_ns: Nanos, name: &str, value: f32) -> MavMessage {
    MavMessage::NAMED_VALUE_FLOAT(NAMED_VALUE_FLOAT_DATA {
        time_boot_ms: time_boot_ms(now_ns),
        value,
        name: name.into(),
    })
}

/// Bits of the reasons that a float holds exactly; two floats hold all of them.
const REASON_BITS: u32 = 24;

/// State and reasons: what is sent at once when it changes. The reasons beyond the bits that a float holds are told apart,
/// while there are or were (`before`) any.
pub(crate) fn state_values(report: &StepReport, before: Reasons) -> impl Iterator<Item = MavMessage> {
    let (now_ns, reasons) = (report.now_ns, report.reasons.0);
    let further = (reasons | before.0) >> REASON_BITS != 0;
    [
        Some(named(now_ns, "gd_state", f32::from(report.state as u8))),
        Some(named(now_ns, "gd_reason", (reasons & ((1 << REASON_BITS) - 1)) as f32)),
        further.then(|| named(now_ns, "gd_reason2", (reasons >> REASON_BITS) as f32)),
    ]
    .into_iter()
    .flatten()
}

/// "goal refused: 812 m from home, at most 500 m".
pub(crate) fn goal_text(distance_m: u32, limit_m: u32) -> StatusText {
    StatusText::new(MavSeverity::MAV_SEVERITY_WARNING, |text| {
        write!(text, "goal refused: {distance_m} m from home, at most {limit_m} m")
    })
}

/// Verdict, score and contributions; without a judgement there is nothing to tell, and a number that is not one is left
/// out.
pub(crate) fn judgement_values(report: &StepReport) -> impl Iterator<Item = MavMessage> {
    let now_ns = report.now_ns;
    report
        .judgement
        .map(|j| {
            [
                ("dt_state", Some(f32::from(j.verdict as u8))),
                ("dt_score", j.score),
                ("dt_img", Some(j.image)),
                ("dt_bear", Some(j.bearing)),
                ("dt_dist", Some(j.distance)),
                ("dt_told", Some(j.told)),
            ]
        })
        .into_iter()
        .flatten()
        .filter_map(move |(name, value)| Some(named(now_ns, name, value.filter(|v| v.is_finite())?)))
}

/// Everything else; what is not known in this step is left out.
pub(crate) fn values(
    report: &StepReport,
    bad_packets: u64,
    telemetry_interval_ns: Option<Nanos>,
) -> impl Iterator<Item = MavMessage> {
    let now_ns = report.now_ns;
    let timing = report.timing;
    let to_goal = report.goal_relative;
    [
        ("goal_m", to_goal.map(|g| g.distance_m)),
        ("goal_deg", to_goal.map(|g| g.bearing_rad.to_degrees())),
        ("frame_ms", report.frame_age_ns.map(|ns| ns as f32 * 1e-6)),
        ("step_us", Some(timing.previous_execution_ns as f32 * 1e-3)),
        ("late_us", Some(timing.wake_late_ns as f32 * 1e-3)),
        ("slips", Some(timing.slips as f32)),
        ("refused", Some(report.frames_refused as f32)),
        ("rx_bad", Some(bad_packets as f32)),
        ("tlm_ms", telemetry_interval_ns.map(|ns| ns as f32 * 1e-6)),
    ]
    .into_iter()
    .filter_map(move |(name, value)| value.map(|value| named(now_ns, name, value)))
}

/// "guidance: hold (stale frame, link lost)".
pub(crate) fn state_text(state: GuidanceState, reasons: Reasons) -> StatusText {
    let severity = if is_faulty_hold(state, reasons) {
        MavSeverity::MAV_SEVERITY_WARNING
    } else {
        MavSeverity::MAV_SEVERITY_INFO
    };
    StatusText::new(severity, |text| {
        write!(text, "guidance: {}", state.name())?;
        write_reasons(text, reasons)
    })
}

/// " (stale frame, link lost)", nothing for none.
fn write_reasons(text: &mut StatusText, reasons: Reasons) -> core::fmt::Result {
    let mut separator = " (";
    for reason in reasons.iter() {
        write!(text, "{separator}{}", reason.name())?;
        separator = ", ";
    }
    text.write_str(if reasons.is_empty() { "" } else { ")" })
}

/// "alarm: attack, stopping", "detector: attack, recovery pilot flies", "detector: clear".
pub(crate) fn alarm_text(alarm: Option<Alarm>) -> StatusText {
    let severity = match alarm.map(|alarm| alarm.response) {
        Some(AlarmResponse::Stop | AlarmResponse::Ignored) => MavSeverity::MAV_SEVERITY_CRITICAL,
        Some(AlarmResponse::Recovery) | None => MavSeverity::MAV_SEVERITY_INFO,
    };
    StatusText::new(severity, |text| match alarm {
        Some(Alarm { cause, response }) => write!(text, "alarm: {}, {}", cause.name(), response.name()),
        None => text.write_str("alarm: clear"),
    })
}

/// "hand-over: arming refused: DENIED".
pub(crate) fn trouble_text(trouble: Trouble, configured: Flavour) -> StatusText {
    StatusText::new(MavSeverity::MAV_SEVERITY_ERROR, |text| match trouble {
        Trouble::Command { number, failure } => {
            write!(text, "hand-over: {} {failure}", command_number::name(number))
        }
        Trouble::OtherAutopilot(named) => write!(
            text,
            "hand-over: vehicle is {}, not {}",
            named.name(),
            configured.name()
        ),
    })
}

/// "GUID_TIMEOUT was 3 s, set to 0.5 s".
pub(crate) fn setpoint_timeout_text(name: &str, finding: Finding) -> StatusText {
    let severity = match finding {
        Finding::Good(_) => MavSeverity::MAV_SEVERITY_INFO,
        Finding::Set(..) => MavSeverity::MAV_SEVERITY_NOTICE,
        Finding::Stays(..) | Finding::NotTold => MavSeverity::MAV_SEVERITY_WARNING,
    };
    StatusText::new(severity, |text| match finding {
        Finding::Good(value_s) => write!(text, "{name} is {value_s} s"),
        Finding::Set(before_s, value_s) => write!(text, "{name} was {before_s} s, set to {value_s} s"),
        Finding::Stays(value_s, wanted_s) => write!(text, "{name} stays {value_s} s, wanted {wanted_s} s"),
        Finding::NotTold => write!(text, "{name} is not told by the vehicle"),
    })
}

/// "hand-over: not done in time, waiting for: climb to the take-off height".
pub(crate) fn overdue_text(unfinished: &str) -> StatusText {
    StatusText::new(MavSeverity::MAV_SEVERITY_ERROR, |text| {
        write!(text, "hand-over: not done in time, waiting for: {unfinished}")
    })
}

/// "vehicle 1: ArduPilot".
pub(crate) fn vehicle_text(system: u8, vehicle: &Vehicle) -> StatusText {
    StatusText::new(MavSeverity::MAV_SEVERITY_INFO, |text| match vehicle.named {
        Some(named) => write!(text, "vehicle {system}: {}", named.name()),
        None => write!(
            text,
            "vehicle {system}: autopilot {} is not known, flown as {}",
            vehicle.mav_autopilot,
            vehicle.flavour().name()
        ),
    })
}

/// "vehicle is ArduPilot, but set is PX4: it is not flown; use --vehicle auto".
pub(crate) fn wrong_vehicle_text(named: Flavour, configured: Flavour) -> StatusText {
    StatusText::new(MavSeverity::MAV_SEVERITY_ERROR, |text| {
        write!(
            text,
            "vehicle is {}, but set is {}: it is not flown; use --vehicle auto",
            named.name(),
            configured.name()
        )
    })
}

/// "slow: ATTITUDE at 2.0 Hz, asked for 50 Hz".
pub(crate) fn slow_text(slow: &Slow) -> StatusText {
    StatusText::new(MavSeverity::MAV_SEVERITY_WARNING, |text| {
        write!(
            text,
            "slow: {} at {:.1} Hz, asked for {:.0} Hz",
            slow.name, slow.rate_hz, slow.wanted_hz
        )
    })
}

/// "telemetry is slow: 4.0 Hz".
pub(crate) fn slow_telemetry_text(interval_ns: Nanos) -> StatusText {
    StatusText::new(MavSeverity::MAV_SEVERITY_WARNING, |text| {
        let rate_hz = 1e9 / interval_ns as f32;
        write!(
            text,
            "slow telemetry: {rate_hz:.1} Hz leave little margin to stale telemetry"
        )
    })
}

/// "home: 12.0 m north, 3.0 m east, 0.0 m above the local origin; goals are from there".
pub(crate) fn home_text(home_ned_m: NedVector) -> StatusText {
    StatusText::new(MavSeverity::MAV_SEVERITY_INFO, |text| {
        let NedVector { x, y, z, .. } = home_ned_m;
        write!(
            text,
            "home: {x:.1} m north, {y:.1} m east, {:.1} m above the local origin; goals are from there",
            -z
        )
    })
}

/// "stop: something 4.2 m ahead on the course", and its like.
pub(crate) fn hold_text(cause: StopCause) -> StatusText {
    StatusText::new(MavSeverity::MAV_SEVERITY_CRITICAL, |text| match cause {
        StopCause::Obstacle { ahead_m } => write!(text, "stop: something {ahead_m:.1} m ahead on the course"),
        StopCause::Blind => text.write_str("stop: nobody sees the course"),
        StopCause::Unseen => text.write_str("stop: it moves where the sensor does not look"),
    })
}

/// What people are told of a guarded flight.
pub(crate) fn guard_text(notice: GuardNotice) -> StatusText {
    StatusText::new(MavSeverity::MAV_SEVERITY_WARNING, |text| {
        text.write_str(match notice {
            GuardNotice::Unguarded => "not guarded: the vehicle does not tell its position",
            GuardNotice::FliesAround => "flying around it to the mission's next place",
            GuardNotice::HandedBack => "handed back: the mission goes on",
            GuardNotice::StaysStopped => {
                "not flown around: guidance cannot take it, or the mission's next place is unknown"
            }
            GuardNotice::Jumped => "the position jumped: what was seen before is forgotten",
        })
    })
}

/// "another guidance computer 1/191 is on the link: stop one".
pub(crate) fn double_text(system: u8, component: u8) -> StatusText {
    StatusText::new(MavSeverity::MAV_SEVERITY_CRITICAL, |text| {
        write!(
            text,
            "another guidance computer {system}/{component} is on the link: stop one"
        )
    })
}

/// Home was not told when the hand-over began.
pub(crate) fn no_home_text() -> StatusText {
    StatusText::new(MavSeverity::MAV_SEVERITY_WARNING, |text| {
        text.write_str("home is not told: goals are from the local origin")
    })
}

/// Why guidance does not engage by itself.
pub(crate) fn pilot_in_command_text(flavour: Flavour) -> StatusText {
    StatusText::new(MavSeverity::MAV_SEVERITY_NOTICE, |text| {
        match flavour {
            // It refuses OFFBOARD while nobody streams setpoints, and guidance streams none while a person has the vehicle.
            Flavour::Px4 => text.write_str("a person has the vehicle: engage guidance when it may go on"),
            Flavour::ArduPilot => write!(
                text,
                "a person has the vehicle: engage guidance, or if nobody took it over, change to {}",
                flavour.external_mode_name()
            ),
        }
    })
}

/// "engage refused in standby (stale frame)".
pub(crate) fn refused_text(request: &str, why: Refusal) -> StatusText {
    StatusText::new(MavSeverity::MAV_SEVERITY_WARNING, |text| match why {
        Refusal::Command(mav_result) => write!(text, "{request} refused: {}", why_refused(mav_result)),
        Refusal::Goal => write!(
            text,
            "{request} refused: outside the fence, too far, or at or below the ground"
        ),
        Refusal::NotGuiding(state) => write!(
            text,
            "{request} refused in {}: guidance does not have the vehicle",
            state.name()
        ),
        Refusal::In(state, reasons) => {
            write!(text, "{request} refused in {}", state.name())?;
            write_reasons(text, reasons)?;
            text.write_str(if reasons.is_empty() {
                ": not clear for long enough"
            } else {
                ""
            })
        }
        Refusal::Busy => write!(text, "{request} refused: too many requests"),
    })
}

/// Why a request was refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Refusal {
    /// The command asks nothing that guidance knows; its MAV_RESULT.
    Command(u8),
    /// The goal is not permitted.
    Goal,
    /// There is nothing to land.
    NotGuiding(GuidanceState),
    /// Not in that state, for those reasons.
    In(GuidanceState, Reasons),
    /// More requests than a step takes.
    Busy,
}

/// "PLT_CRUISE not set: out of range".
pub(crate) fn parameter_text(name: &str, why: &str) -> StatusText {
    StatusText::new(MavSeverity::MAV_SEVERITY_WARNING, |text| {
        write!(text, "{name} not set: {why}")
    })
}

/// The last words.
pub(crate) fn shutdown_text() -> StatusText {
    StatusText::new(MavSeverity::MAV_SEVERITY_NOTICE, |text| {
        text.write_str("guidance: shut down")
    })
}
