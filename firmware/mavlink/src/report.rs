//! What the guidance computer says of itself: HEARTBEAT, NAMED_VALUE_FLOAT, and its setpoints.

use crate::status_text::{INFO, WARNING};
use mavlink::dialects::common::{
    ComputerStatusFlags, HEARTBEAT_DATA, MavAutopilot, MavFrame, MavMessage, MavModeFlag, MavSeverity, MavState,
    MavType, NAMED_VALUE_FLOAT_DATA, ONBOARD_COMPUTER_STATUS_DATA, PositionTargetTypemask,
    SET_POSITION_TARGET_LOCAL_NED_DATA,
};
use vigil_types::{GuidanceState, Nanos, Reason, Reasons, StepReport, VelocitySetpoint};

/// MAVLink's time since boot. Wraps after 49 days, as the protocol's field does.
pub(crate) fn time_boot_ms(now_ns: Nanos) -> u32 {
    (now_ns / 1_000_000) as u32
}

/// A heartbeat with base_mode 0 and no autopilot, so that nobody takes it for the vehicle's.
pub(crate) fn heartbeat(mavtype: MavType, system_status: MavState) -> MavMessage {
    MavMessage::HEARTBEAT(HEARTBEAT_DATA {
        custom_mode: 0,
        mavtype,
        autopilot: MavAutopilot::MAV_AUTOPILOT_INVALID,
        base_mode: MavModeFlag::empty(),
        system_status,
        mavlink_version: 3,
    })
}

/// ONBOARD_COMPUTER_STATUS: `busy_percent` of the last ten slices of 100 ms, oldest first, that the steps took of their
/// core. Whatever the tick does not know of its computer has the protocol's value for it: `MAX`, for a core 255.
/// <https://mavlink.io/en/messages/common.html#ONBOARD_COMPUTER_STATUS>
pub(crate) fn onboard_computer(now_ns: Nanos, busy_percent: [u8; 10]) -> MavMessage {
    MavMessage::ONBOARD_COMPUTER_STATUS(ONBOARD_COMPUTER_STATUS_DATA {
        time_usec: now_ns / 1_000,
        uptime: time_boot_ms(now_ns),
        ram_usage: u32::MAX,
        ram_total: u32::MAX,
        storage_type: [u32::MAX; 4],
        storage_usage: [u32::MAX; 4],
        storage_total: [u32::MAX; 4],
        link_type: [u32::MAX; 6],
        link_tx_rate: [u32::MAX; 6],
        link_rx_rate: [u32::MAX; 6],
        link_tx_max: [u32::MAX; 6],
        link_rx_max: [u32::MAX; 6],
        fan_speed: [i16::MAX; 4],
        mavtype: 0,
        cpu_cores: [u8::MAX; 8],
        cpu_combined: busy_percent,
        gpu_cores: [u8::MAX; 4],
        gpu_combined: [u8::MAX; 10],
        temperature_board: i8::MAX,
        temperature_core: [i8::MAX; 8],
        status_flags: ComputerStatusFlags::empty(),
    })
}

/// Holding at the goal or by an operator's wish is in order, whatever is only warned of; any other hold is not.
fn is_faulty_hold(state: GuidanceState, reasons: Reasons) -> bool {
    let in_order = Reasons::of(Reason::GoalReached)
        .union(Reasons::of(Reason::Operator))
        .union(Reasons::of(Reason::SlowTelemetry));
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

/// State and reasons: what is sent at once when it changes.
pub(crate) fn state_values(report: &StepReport) -> [MavMessage; 3] {
    let (now_ns, reasons) = (report.now_ns, report.reasons.0);
    [
        named(now_ns, "gd_state", f32::from(report.state as u8)),
        named(now_ns, "gd_reason", (reasons & ((1 << REASON_BITS) - 1)) as f32),
        named(now_ns, "gd_reason2", (reasons >> REASON_BITS) as f32),
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

/// How severe it is that guidance is in a state.
pub(crate) fn severity(state: GuidanceState, reasons: Reasons) -> MavSeverity {
    if is_faulty_hold(state, reasons) { WARNING } else { INFO }
}

/// " (stale frame, link lost)", nothing for none.
pub(crate) struct InBrackets(pub Reasons);

impl core::fmt::Display for InBrackets {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let mut separator = " (";
        for reason in self.0.iter() {
            write!(f, "{separator}{}", reason.name())?;
            separator = ", ";
        }
        f.write_str(if self.0.is_empty() { "" } else { ")" })
    }
}
