//! The hand-over of the vehicle to the guidance computer, and the way back to the ground.
//!
//! What to ask next follows in each step from the vehicle's own telemetry; nothing is assumed to have happened because it
//! was acknowledged. The autopilots differ in the order of stages and in when they bear setpoints ([`Flavour`]).

use super::{Service, Step};
use crate::autopilot::{Flavour, command_number};
use crate::core::Core;
use crate::framing::{Command, CommandAck, CommandForm, Packet};
use crate::operator::result;
use crate::status_text::{CRITICAL, ERROR};
use crate::vehicle::Vehicle;
use core::fmt::Arguments;
use core::mem::discriminant;
use vigil_types::{
    Datagrams, HandoverProgress, Heartbeat, Landed, Nanos, Reason, StopCause, VehicleMode, VehicleRequest,
};

/// PX4 wants setpoints for this long before it changes to OFFBOARD.
const PRE_STREAM_NS: Nanos = 1_000_000_000;
/// Heartbeats come at 1 Hz: an accepted command may take this long to show.
const EFFECT_NS: Nanos = 3_000_000_000;
/// Motors spin up before a take-off shows.
const TAKEOFF_EFFECT_NS: Nanos = 10_000_000_000;
/// A land command that failed is asked again after this pause; there is nothing better to do.
const LAND_PAUSE_NS: Nanos = 2_000_000_000;
/// The same for the modes of a guarded flight: something lies ahead.
const HOLD_PAUSE_NS: Nanos = 200_000_000;
/// Fastest on the way to the place of a stop, where the autopilot bears a speed with it, metres per second: it is to brake, and what it
/// passes the place by is flown back slowly.
const STOP_SPEED_M_S: f32 = 1.0;
/// How far below the asked height a climb counts as finished: a tenth of it, at most this.
const CLIMB_TOLERANCE_M: f32 = 0.3;
/// MAV_FRAME_GLOBAL.
const GLOBAL: u8 = 0;
/// A heartbeat this much later than the beginning of a climb shows the mode that the take-off put the vehicle into.
const MODE_SHOWS_NS: Nanos = 1_000_000_000;

#[derive(Debug, Clone, Copy)]
enum Stage {
    Ask(Wanted),
    Wait,
    Done,
}

/// Follows one request of guidance.
#[derive(Debug, Clone, Default)]
pub(crate) struct HandoverService {
    flavour: Flavour,
    /// How far the vehicle is with it.
    pub progress: HandoverProgress,
    tracker: Tracker,
    /// The first of its kind; in all steps since then the same was asked.
    asked: VehicleRequest,
    /// The vehicle does not take the place of a stop.
    refuses_place: bool,
    streaming_since_ns: Option<Nanos>,
    /// A take-off was seen or accepted at this time and has not reached its height.
    climbing_since_ns: Option<Nanos>,
    failed_ns: Option<Nanos>,
}

impl HandoverService {
    /// What an unfinished hand-over waits for; `None` when there is none.
    fn unfinished(&self) -> Option<&'static str> {
        if !matches!(self.progress, HandoverProgress::InProgress { .. }) {
            return None;
        }
        Some(match (self.climbing_since_ns, self.tracker.number) {
            (Some(_), _) => "climb to the take-off height",
            (None, Some(number)) => command_number::name(number),
            (None, None) => "stream of setpoints",
        })
    }

    /// One step. `streaming`: a setpoint is sent in it.
    fn step(&mut self, now_ns: Nanos, request: VehicleRequest, streaming: bool, vehicle: &Vehicle) -> Next {
        self.flavour = vehicle.flavour();
        self.streaming_since_ns = if streaming {
            self.streaming_since_ns.or(Some(now_ns))
        } else {
            None
        };
        if discriminant(&self.asked) != discriminant(&request) {
            *self = Self {
                flavour: self.flavour,
                streaming_since_ns: self.streaming_since_ns,
                asked: request,
                ..Self::default()
            };
        }
        match request {
            VehicleRequest::None => Next::Wait,
            VehicleRequest::FlyExternal { takeoff_height_m } => self.fly(now_ns, takeoff_height_m, vehicle),
            VehicleRequest::Land => {
                let wanted = self.wanted(command_number::NAV_LAND, EFFECT_NS, &[]);
                self.insist(now_ns, &wanted, LAND_PAUSE_NS, vehicle)
            }
            VehicleRequest::Hold { place_m, .. } => {
                let wanted = match self.flavour {
                    Flavour::Px4 => self.px4_stop(place_m, vehicle),
                    Flavour::ArduPilot => self.set_mode(VehicleMode::Hold),
                };
                let next = self.insist(now_ns, &wanted, HOLD_PAUSE_NS, vehicle);
                self.refuses_place |= wanted.place.is_some() && matches!(next, Next::Failed(..));
                next
            }
            VehicleRequest::Resume => {
                let wanted = self.set_mode(VehicleMode::Mission);
                self.insist(now_ns, &wanted, HOLD_PAUSE_NS, vehicle)
            }
        }
    }

    /// The mode first, which every PX4 takes. It holds a point that it projects from its velocity alone, and flies back to it if it was
    /// gaining speed: so it is sent the place where it can stop as soon as it has the mode.
    fn px4_stop(&self, place_m: Option<(f32, f32)>, vehicle: &Vehicle) -> Wanted {
        let holds = vehicle.telemetry.heartbeat.is_some_and(|h| h.mode == VehicleMode::Hold);
        let has_mode = holds
            || self.tracker.is_accepted(command_number::DO_SET_MODE)
            || self.tracker.number == Some(command_number::DO_REPOSITION);
        // An origin that was inferred from home may be metres aside.
        let origin = vehicle
            .origin
            .filter(|_| vehicle.is_origin_known() && !self.refuses_place);
        let reposition = |speed_m_s| {
            let set = [(1, speed_m_s), (2, 1.0), (3, 0.0)];
            self.wanted(command_number::DO_REPOSITION, EFFECT_NS, &set)
        };
        let place = origin
            .zip(place_m)
            .and_then(|(origin, (north_m, east_m))| origin.place_e7(north_m, east_m));
        match place {
            Some(_) if has_mode => Wanted {
                place,
                ..reposition(STOP_SPEED_M_S)
            },
            // In hold it may be on its way to a place; the mode that it has already changes nothing. A go-to without a place is how
            // ground stations pause one.
            _ if holds => reposition(-1.0),
            _ => self.set_mode(VehicleMode::Hold),
        }
    }

    fn set_mode(&self, mode: VehicleMode) -> Wanted {
        let [base, main, sub] = self.flavour.mode_params(mode);
        let set = [(1, base), (2, main), (3, sub)];
        self.wanted(command_number::DO_SET_MODE, EFFECT_NS, &set)
    }

    fn fly(&mut self, now_ns: Nanos, takeoff_height_m: f32, vehicle: &Vehicle) -> Next {
        if self.progress == HandoverProgress::Failed {
            return Next::Wait;
        }
        if let (true, Some(named)) = (vehicle.is_other_autopilot(), vehicle.named) {
            self.progress = HandoverProgress::Failed;
            return Next::OtherAutopilot(named);
        }
        let stage = match self.flavour {
            Flavour::Px4 => self.px4_stage(now_ns, takeoff_height_m, vehicle),
            Flavour::ArduPilot => self.copter_stage(now_ns, takeoff_height_m, vehicle),
        };
        self.progress = match stage {
            Stage::Done => HandoverProgress::Done,
            Stage::Ask(_) | Stage::Wait => HandoverProgress::InProgress {
                // A Copter's take-off ends with the first setpoint.
                stream_setpoints: self.flavour == Flavour::Px4,
            },
        };
        let Stage::Ask(wanted) = stage else {
            return Next::Wait;
        };
        let next = self.tracker.next(now_ns, &wanted);
        if matches!(next, Next::Failed(..)) {
            self.progress = HandoverProgress::Failed;
        }
        next
    }

    /// Arm, take off, stream, OFFBOARD.
    fn px4_stage(&mut self, now_ns: Nanos, takeoff_height_m: f32, vehicle: &Vehicle) -> Stage {
        let Some(heartbeat) = vehicle.telemetry.heartbeat else {
            return Stage::Wait;
        };
        let airborne = vehicle.telemetry.is_airborne();
        if heartbeat.armed && airborne && heartbeat.mode == VehicleMode::External {
            return Stage::Done;
        }
        if !heartbeat.armed {
            return Stage::Ask(self.arm());
        }
        self.note_climb(now_ns, takeoff_height_m, vehicle, &heartbeat);
        // On the ground a height that counts as reached, from another origin, is no climb.
        if !airborne && (heartbeat.mode != VehicleMode::Takeoff || self.climbing_since_ns.is_none()) {
            return Stage::Ask(self.take_off(takeoff_height_m, vehicle));
        }
        if let Some(since_ns) = self.climbing_since_ns {
            // A climb that ended below the asked height (the vehicle took its own) shows by its mode.
            let mode_shows = heartbeat.at_ns.saturating_sub(since_ns) > MODE_SHOWS_NS;
            if !mode_shows || heartbeat.mode == VehicleMode::Takeoff {
                return Stage::Wait;
            }
        }
        match self.streaming_since_ns {
            Some(since_ns) if now_ns.saturating_sub(since_ns) >= PRE_STREAM_NS => {
                Stage::Ask(self.set_mode(VehicleMode::External))
            }
            _ => Stage::Wait,
        }
    }

    /// GUIDED, arm, take off.
    fn copter_stage(&mut self, now_ns: Nanos, takeoff_height_m: f32, vehicle: &Vehicle) -> Stage {
        let Some(heartbeat) = vehicle.telemetry.heartbeat else {
            return Stage::Wait;
        };
        if heartbeat.mode != VehicleMode::External {
            return Stage::Ask(self.set_mode(VehicleMode::External));
        }
        if !heartbeat.armed {
            return Stage::Ask(self.arm());
        }
        self.note_climb(now_ns, takeoff_height_m, vehicle, &heartbeat);
        match (vehicle.telemetry.is_airborne(), self.climbing_since_ns) {
            (false, _) => Stage::Ask(self.take_off(takeoff_height_m, vehicle)),
            (true, Some(_)) => Stage::Wait,
            (true, None) => Stage::Done,
        }
    }

    fn note_climb(&mut self, now_ns: Nanos, takeoff_height_m: f32, vehicle: &Vehicle, heartbeat: &Heartbeat) {
        let begun = heartbeat.mode == VehicleMode::Takeoff
            || vehicle.telemetry.landed == Landed::TakingOff
            || self.tracker.is_accepted(command_number::NAV_TAKEOFF);
        let climb_m = (takeoff_height_m - vehicle.home_height_m()).max(0.0);
        let reached_m = takeoff_height_m - CLIMB_TOLERANCE_M.min(0.1 * climb_m);
        if height_m(vehicle).is_some_and(|height_m| height_m >= reached_m) {
            self.climbing_since_ns = None;
        } else if begun {
            self.climbing_since_ns = self.climbing_since_ns.or(Some(now_ns));
        }
    }

    fn wanted(&self, number: u16, effect_ns: Nanos, set: &[(usize, f32)]) -> Wanted {
        Wanted {
            number,
            params: self.flavour.params(set),
            place: None,
            effect_ns,
        }
    }

    fn arm(&self) -> Wanted {
        // Parameter 2 set would force it.
        self.wanted(command_number::COMPONENT_ARM_DISARM, EFFECT_NS, &[(1, 1.0), (2, 0.0)])
    }

    fn take_off(&self, takeoff_height_m: f32, vehicle: &Vehicle) -> Wanted {
        let altitude_m = match self.flavour {
            // Above sea level; unknown, the vehicle takes its own height.
            Flavour::Px4 => vehicle.origin.map_or(f32::NAN, |origin| {
                (origin.altitude_m + f64::from(takeoff_height_m)) as f32
            }),
            // Above home.
            Flavour::ArduPilot => takeoff_height_m - vehicle.home_height_m(),
        };
        self.wanted(command_number::NAV_TAKEOFF, TAKEOFF_EFFECT_NS, &[(7, altitude_m)])
    }

    /// Asks until it is done: what failed is asked again after a pause.
    fn insist(&mut self, now_ns: Nanos, wanted: &Wanted, pause_ns: Nanos, vehicle: &Vehicle) -> Next {
        if vehicle.is_other_autopilot() {
            return Next::Wait;
        }
        if let Some(failed_ns) = self.failed_ns {
            if now_ns.saturating_sub(failed_ns) < pause_ns {
                return Next::Wait;
            }
            self.failed_ns = None;
            self.tracker = Tracker::default();
        }
        let next = self.tracker.next(now_ns, wanted);
        if matches!(next, Next::Failed(..)) {
            self.failed_ns = Some(now_ns);
        }
        next
    }
}

fn height_m(vehicle: &Vehicle) -> Option<f32> {
    vehicle.telemetry.kinematics.map(|k| -k.position_ned_m.z)
}

impl Service for HandoverService {
    fn hear_vehicle(&mut self, core: &mut Core, now_ns: Nanos, packet: &Packet<'_>) {
        if let Some(ack) = packet.command_ack()
            && core.is_for_me_or_all(ack.target_system, ack.target_component)
        {
            self.tracker.acknowledge(now_ns, &ack);
        }
    }

    fn speak(&mut self, core: &mut Core, step: &Step<'_>, out: &mut Datagrams) {
        let is_overdue = step.report.reasons.contains(Reason::HandoverFailed);
        if let (VehicleRequest::None, true, Some(unfinished)) = (step.request, is_overdue, self.unfinished()) {
            let text = format_args!("hand-over: not done in time, waiting for: {unfinished}");
            core.tell(out, ERROR, text);
        }
        if let VehicleRequest::Hold { cause: Some(cause), .. } = step.request
            && !matches!(self.asked, VehicleRequest::Hold { .. } | VehicleRequest::Resume)
        {
            let mut tell = |text: Arguments<'_>| core.tell(out, CRITICAL, text);
            match cause {
                StopCause::Obstacle { ahead_m } => {
                    tell(format_args!("stop: something {ahead_m:.1} m ahead on the course"));
                }
                StopCause::Blind => tell(format_args!("stop: nobody sees the course")),
                StopCause::Unseen => tell(format_args!("stop: it moves where the sensor does not look")),
            }
        }
        let next = self.step(step.report.now_ns, step.request, core.streaming, &core.vehicle);
        let Some(system) = core.system_id else { return };
        match next {
            Next::Wait => {}
            Next::Send(wanted, confirmation) => {
                let mut command = Command::to_autopilot(system, wanted.number, wanted.params, confirmation);
                if let Some((x, y)) = wanted.place {
                    command.form = CommandForm::Int { frame: GLOBAL, x, y };
                }
                core.command(out, &command);
            }
            Next::Failed(number, failure) => {
                let text = format_args!("hand-over: {} {failure}", command_number::name(number));
                core.tell(out, ERROR, text);
            }
            Next::OtherAutopilot(named) => {
                let (named, configured) = (named.name(), self.flavour.name());
                let text = format_args!("hand-over: vehicle is {named}, not {configured}");
                core.tell(out, ERROR, text);
            }
        }
    }
}

/// Attempts before a command counts as not answered.
const ATTEMPTS: u8 = 4;
/// Pause between attempts.
const RETRY_NS: Nanos = 500_000_000;
/// IN_PROGRESS is waited for this long after its last sign.
const PROGRESS_NS: Nanos = 10_000_000_000;

/// A command of the hand-over.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Wanted {
    number: u16,
    params: [f32; 7],
    /// Latitude and longitude in place of parameters 5 and 6, 1e-7 degrees: it goes as a COMMAND_INT.
    place: Option<(i32, i32)>,
    /// How long its effect may take to be seen after it was accepted; then it is sent again.
    effect_ns: Nanos,
}

/// Why a command failed: the last answer to it, a MAV_RESULT, if one came.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Failure(Option<u8>);

impl core::fmt::Display for Failure {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self.0 {
            None => f.write_str("not answered"),
            // It never showed in the telemetry.
            Some(result::ACCEPTED | result::IN_PROGRESS) => f.write_str("accepted, but without effect"),
            Some(refused) => write!(f, "refused: {}", result::name(refused)),
        }
    }
}

/// What to do in this step.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Next {
    Wait,
    /// Send it; the number is COMMAND_LONG's confirmation.
    Send(Wanted, u8),
    /// A command with this number failed, which people read once.
    Failed(u16, Failure),
    /// The same for a vehicle that names another autopilot than the configured one.
    OtherAutopilot(Flavour),
}

/// Follows one command number, one at a time: repeated until it is answered, given up after four attempts.
/// <https://mavlink.io/en/services/command.html>
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
struct Tracker {
    /// The command that is followed.
    number: Option<u16>,
    sent: u8,
    /// When it was sent, or last answered.
    at_ns: Nanos,
    /// MAV_RESULT, since it was sent last.
    answer: Option<u8>,
}

impl Tracker {
    /// What to do about the wanted command in this step. Another command than before begins anew.
    fn next(&mut self, now_ns: Nanos, wanted: &Wanted) -> Next {
        if self.number != Some(wanted.number) {
            *self = Self {
                number: Some(wanted.number),
                ..Self::default()
            };
        }
        let failed = Next::Failed(wanted.number, Failure(self.answer));
        let patience_ns = match self.answer {
            None | Some(result::TEMPORARILY_REJECTED) => RETRY_NS,
            Some(result::ACCEPTED) => wanted.effect_ns,
            Some(result::IN_PROGRESS) => PROGRESS_NS,
            Some(_) => return failed,
        };
        if self.sent > 0 && now_ns.saturating_sub(self.at_ns) < patience_ns {
            return Next::Wait;
        }
        if self.sent >= ATTEMPTS {
            return failed;
        }
        let confirmation = self.sent;
        (self.sent, self.at_ns, self.answer) = (confirmation + 1, now_ns, None);
        Next::Send(*wanted, confirmation)
    }

    /// Takes an acknowledgement; one of another command is ignored.
    fn acknowledge(&mut self, now_ns: Nanos, ack: &CommandAck) {
        if self.number == Some(ack.command) {
            (self.at_ns, self.answer) = (now_ns, Some(ack.result));
        }
    }

    /// Whether the command with this number was accepted and nothing else asked since.
    fn is_accepted(&self, number: u16) -> bool {
        (self.number, self.answer) == (Some(number), Some(result::ACCEPTED))
    }
}
