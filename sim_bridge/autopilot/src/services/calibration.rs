//! PREFLIGHT_CALIBRATION, reported by PX4's `[cal]` texts, which MAVSDK and QGroundControl read.
//!
//! The simulated sensors have no offset that lasts, so a calibration measures and reports; it changes nothing. Those that
//! need the vehicle turned by hand are refused.

use crate::service::prelude::*;
use crate::vehicle::VehicleView;
use vigil_mavlink::framing::CommandForm;

const PREFLIGHT_CALIBRATION: u16 = 241;
const LASTS_NS: Nanos = 1_000_000_000;
const LOOK_NS: Nanos = 10_000_000;
/// A mean rate or tilt beyond these is no offset: the vehicle moves or stands on a slope.
const MAX_RATE_RAD_S: f32 = 0.05;
const MAX_TILT_RAD: f32 = 0.1;

#[derive(Debug)]
struct Running {
    name: &'static str,
    look: fn(&VehicleView) -> [f32; 3],
    limit: f32,
    began_ns: Nanos,
    looks: u16,
    sums: [f32; 3],
    told_half: bool,
    is_cancelled: bool,
}

#[derive(Debug, Default)]
pub(crate) struct Calibration {
    running: Option<Running>,
    due_ns: Nanos,
}

impl Service for Calibration {
    fn serves(&self, command: u16) -> bool {
        command == PREFLIGHT_CALIBRATION
    }

    fn command(&mut self, command: &Command, _source: Source, core: &mut Core) -> Answer {
        let mut params: [f32; 7] = std::array::from_fn(|i| command.param(i + 1).unwrap_or(0.0));
        if let CommandForm::Int { x, .. } = command.form
            && !matches!(x, i32::MIN | i32::MAX)
        {
            params[4] = x as f32;
        }
        let (name, look, limit): (_, fn(&VehicleView) -> _, _) = match params {
            p if p == [0.0; 7] => {
                if let Some(running) = &mut self.running {
                    // Said in the next step: MAVSDK takes no text before the acknowledgement that it waits for.
                    running.is_cancelled = true;
                    self.due_ns = core.now_ns;
                }
                return Ok(());
            }
            [1.0, ..] => (
                "gyro",
                |view| view.sensors.gyroscope_frd_rad_s.to_array(),
                MAX_RATE_RAD_S,
            ),
            [_, _, _, _, 2.0, ..] => ("level", tilt, MAX_TILT_RAD),
            [_, 1.0, ..] | [_, _, _, _, 1.0, ..] => {
                let text = "calibration denied: nobody turns a simulated vehicle by hand";
                return Err(Refusal::REJECTED.saying(text));
            }
            _ => return Err(Refusal::UNSUPPORTED),
        };
        if core.commander.armed {
            return Err(Refusal::REJECTED.saying("calibration denied: armed"));
        }
        if self.running.is_some() {
            return Err(Refusal::REJECTED.saying("calibration denied: another one is running"));
        }
        core.inform(&format!("[cal] calibration started: 2 {name}"));
        self.due_ns = core.now_ns + LOOK_NS;
        self.running = Some(Running {
            name,
            look,
            limit,
            began_ns: core.now_ns,
            looks: 0,
            sums: [0.0; 3],
            told_half: false,
            is_cancelled: false,
        });
        Ok(())
    }

    fn due_ns(&self) -> Nanos {
        self.running.as_ref().map_or(Nanos::MAX, |_| self.due_ns)
    }

    fn step(&mut self, core: &mut Core) {
        self.due_ns = core.now_ns + LOOK_NS;
        let Some(running) = &mut self.running else {
            return;
        };
        if running.is_cancelled {
            self.running = None;
            return core.inform("[cal] calibration cancelled");
        }
        for (sum, value) in running.sums.iter_mut().zip((running.look)(&core.view)) {
            *sum += value;
        }
        running.looks += 1;
        let elapsed_ns = core.now_ns.saturating_sub(running.began_ns);
        if elapsed_ns >= LASTS_NS / 2 && !std::mem::replace(&mut running.told_half, true) {
            core.inform("[cal] progress <50>");
        }
        if elapsed_ns < LASTS_NS && !core.commander.armed {
            return;
        }
        let (name, limit, count) = (running.name, running.limit, f32::from(running.looks));
        let is_beyond = |sum: f32| (sum / count).abs() > limit;
        let moved = running.sums.into_iter().any(is_beyond);
        self.running = None;
        let failure = match core.commander.armed {
            true => "armed".to_owned(),
            false if moved => format!("{name} moved"),
            false => {
                core.inform("[cal] progress <100>");
                return core.inform(&format!("[cal] calibration done: {name}"));
            }
        };
        let text = format!("[cal] calibration failed: {failure}");
        core.text(MavSeverity::MAV_SEVERITY_CRITICAL, &text);
    }
}

fn tilt(view: &VehicleView) -> [f32; 3] {
    let attitude = view.estimate.attitude;
    [attitude.roll_rad(), attitude.pitch_rad(), 0.0]
}
