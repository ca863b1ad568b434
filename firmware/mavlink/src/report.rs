//! What the guidance computer says of itself: HEARTBEAT, NAMED_VALUE_FLOAT, STATUSTEXT, and its setpoints.

use crate::autopilot::{Flavour, command_number};
use crate::handover::Trouble;
use crate::setpoint_timeout::Finding;
use core::fmt::Write;
use mavlink::dialects::common::{
    HEARTBEAT_DATA, MavAutopilot, MavFrame, MavMessage, MavModeFlag, MavParamError, MavSeverity, MavState, MavType,
    NAMED_VALUE_FLOAT_DATA, PARAM_ERROR_DATA, PositionTargetTypemask, SET_POSITION_TARGET_LOCAL_NED_DATA,
    STATUSTEXT_DATA,
};
use vigil_types::{Alarm, AlarmResponse, GuidanceState, Nanos, Reason, Reasons, StepReport, VelocitySetpoint};

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

/// State and reasons: what is sent at once when it changes.
pub(crate) fn state_values(report: &StepReport) -> [MavMessage; 2] {
    [
        named(report.now_ns, "gd_state", f32::from(report.state as u8)),
        // 20 bits: exact in a float.
        named(report.now_ns, "gd_reason", report.reasons.0 as f32),
    ]
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
            ]
        })
        .into_iter()
        .flatten()
        .filter_map(move |(name, value)| Some(named(now_ns, name, value.filter(|v| v.is_finite())?)))
}

/// Everything else; what is not known in this step is left out.
pub(crate) fn values(report: &StepReport, bad_packets: u64) -> impl Iterator<Item = MavMessage> {
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
    ]
    .into_iter()
    .filter_map(move |(name, value)| value.map(|value| named(now_ns, name, value)))
}

/// The text of one STATUSTEXT, cut at its 50 bytes.
struct Text {
    bytes: [u8; 50],
    len: usize,
}

impl Write for Text {
    fn write_str(&mut self, s: &str) -> core::fmt::Result {
        // All names are ASCII, so that a cut never splits a character.
        for (slot, byte) in self.bytes.iter_mut().skip(self.len).zip(s.bytes()) {
            *slot = byte;
            self.len += 1;
        }
        Ok(())
    }
}

fn status_text(severity: MavSeverity, write: impl FnOnce(&mut Text) -> core::fmt::Result) -> MavMessage {
    let mut text = Text { bytes: [0; 50], len: 0 };
    // Cannot fail: `Text` never does.
    let _ = write(&mut text);
    MavMessage::STATUSTEXT(STATUSTEXT_DATA {
        severity,
        text: text.bytes.into(),
        ..STATUSTEXT_DATA::DEFAULT
    })
}

/// "guidance: hold (stale frame, link lost)".
pub(crate) fn state_text(state: GuidanceState, reasons: Reasons) -> MavMessage {
    let severity = if is_faulty_hold(state, reasons) {
        MavSeverity::MAV_SEVERITY_WARNING
    } else {
        MavSeverity::MAV_SEVERITY_INFO
    };
    status_text(severity, |text| {
        write!(text, "guidance: {}", state.name())?;
        let mut separator = " (";
        for reason in reasons.iter() {
            write!(text, "{separator}{}", reason.name())?;
            separator = ", ";
        }
        text.write_str(if reasons.is_empty() { "" } else { ")" })
    })
}

/// "alarm: attack, stopping", "detector: attack, recovery pilot flies", "detector: clear".
pub(crate) fn alarm_text(alarm: Option<Alarm>) -> MavMessage {
    let severity = match alarm.map(|alarm| alarm.response) {
        Some(AlarmResponse::Stop | AlarmResponse::Ignored) => MavSeverity::MAV_SEVERITY_CRITICAL,
        Some(AlarmResponse::Recovery) | None => MavSeverity::MAV_SEVERITY_INFO,
    };
    status_text(severity, |text| match alarm {
        Some(Alarm { cause, response }) => write!(text, "alarm: {}, {}", cause.name(), response.name()),
        None => text.write_str("alarm: clear"),
    })
}

/// "hand-over: arm denied".
pub(crate) fn trouble_text(trouble: Trouble, configured: Flavour) -> MavMessage {
    status_text(MavSeverity::MAV_SEVERITY_ERROR, |text| match trouble {
        Trouble::Command { number, failure } => {
            write!(text, "hand-over: {} {}", command_number::name(number), failure.name())
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
pub(crate) fn setpoint_timeout_text(name: &str, finding: Finding) -> MavMessage {
    let severity = match finding {
        Finding::Good(_) => MavSeverity::MAV_SEVERITY_INFO,
        Finding::Set(..) => MavSeverity::MAV_SEVERITY_NOTICE,
        Finding::Stays(..) | Finding::NotTold => MavSeverity::MAV_SEVERITY_WARNING,
    };
    status_text(severity, |text| match finding {
        Finding::Good(value_s) => write!(text, "{name} is {value_s} s"),
        Finding::Set(before_s, value_s) => write!(text, "{name} was {before_s} s, set to {value_s} s"),
        Finding::Stays(value_s, wanted_s) => write!(text, "{name} stays {value_s} s, wanted {wanted_s} s"),
        Finding::NotTold => write!(text, "{name} is not told by the vehicle"),
    })
}

/// "PLT_CRUISE not set: out of range".
pub(crate) fn parameter_text(name: &str, why: &str) -> MavMessage {
    status_text(MavSeverity::MAV_SEVERITY_WARNING, |text| {
        write!(text, "{name} not set: {why}")
    })
}

/// PARAM_ERROR to who asked for a parameter that there is not: by name, or by index where that is not -1.
pub(crate) fn no_such_parameter((system, component): (u8, u8), name: [u8; 16], param_index: i16) -> MavMessage {
    MavMessage::PARAM_ERROR(PARAM_ERROR_DATA {
        param_index,
        target_system: system,
        target_component: component,
        param_id: name.into(),
        error: MavParamError::MAV_PARAM_ERROR_DOES_NOT_EXIST,
    })
}

/// The last words.
pub(crate) fn shutdown_text() -> MavMessage {
    status_text(MavSeverity::MAV_SEVERITY_NOTICE, |text| {
        text.write_str("guidance: shut down")
    })
}
