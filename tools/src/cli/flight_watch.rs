//! A flight that is monitored to its end: what is shown meanwhile, and what is kept of it.

use crate::cli::child_process::{LOOK, next_status};
use crate::cli::fly::Processes;
use crate::cli::foreign::{PilotWatch, held_for, is_pose_lost};
use crate::cli::live::{Live, state_line};
use crate::cli::output::{Interrupt, say, tell};
use anyhow::{Result, ensure};
use indicatif::{ProgressBar, ProgressStyle};
use std::time::{Duration, Instant};
use vigil_sim::program::Status;
use vigil_sim::world::Outcome;
use vigil_types::{Attitude, Nanos, NedVector};

/// After reaching the goal the vehicle may take this long to land.
const LANDING_LIMIT: Duration = Duration::from_secs(30);
/// A vehicle that flew and stands disarmed for so long does not go on: its autopilot, or a person, ended the flight.
const DISARMED_LIMIT: Duration = Duration::from_secs(5);
/// Above this height it flies, metres; above half of a course's that is flown lower than twice this.
const FLIES_M: f32 = 1.0;
/// A simulator that says nothing for so many looks in a row is given up: looks, since time goes on while this process is stopped.
const SILENT_LOOKS: u32 = 25;

/// When, where and how the vehicle was in truth.
pub(super) type TruePose = (Nanos, NedVector, Attitude);

/// What was seen of a flight.
#[derive(Default)]
pub(super) struct Flight {
    pub(super) last: Option<Status>,
    /// True poses up to the end of the watch.
    pub(super) truth: Vec<TruePose>,
    /// True positions up to the ending.
    pub(super) path: Vec<NedVector>,
}

/// What is shown while it flies.
pub(super) enum Terminal {
    Quiet,
    /// A line every two seconds.
    Lines {
        /// What stands before each.
        title: String,
        /// Of the simulation, when the last one was printed.
        printed_s: f64,
    },
    /// A picture that is drawn anew.
    Live(Box<Live>),
}

impl Flight {
    fn keep(&mut self, status: Status) {
        // Of a foreign vehicle that cannot be placed there is nothing to keep.
        if status.pose.is_none() {
            let [x, y, z] = status.position_ned_m;
            let position_ned_m = NedVector::new(x, y, z);
            if status.outcome.is_none() {
                self.path.push(position_ned_m);
            }
            let [w, x, y, z] = status.attitude;
            self.truth.push((status.at_ns, position_ned_m, Attitude { w, x, y, z }));
        }
        self.last = Some(status);
    }
}

impl Terminal {
    fn show(&mut self, bar: &ProgressBar, path: &[NedVector], status: &Status) {
        match self {
            Self::Live(live) => {
                bar.set_message(live.picture(path, status));
                bar.tick();
            }
            Self::Lines { title, printed_s } if status.time_s - *printed_s >= 2.0 => {
                tell!("{title}  {}", state_line(status));
                *printed_s = status.time_s;
            }
            Self::Lines { .. } | Self::Quiet => {}
        }
    }
}

/// Follows the flight until it is over, which may be an error; what was seen until then is kept.
pub(super) fn watch(
    terminal: &mut Terminal,
    processes: &mut Processes,
    interrupt: &Interrupt,
    flight: &mut Flight,
    height_m: f32,
) -> Result<()> {
    let flies_m = FLIES_M.min(0.5 * height_m);
    let bar = ProgressBar::new_spinner().with_style(ProgressStyle::with_template("{msg}")?);
    let (mut has_flown, mut silent_looks, mut pilot) = (false, 0, PilotWatch::default());
    let [mut reached_at, mut disarmed_at, mut no_pose_since] = [None::<Instant>; 3];
    let is_quiet = matches!(terminal, Terminal::Quiet);
    while !interrupt.came() {
        let in_flight = has_flown || flight.last.as_ref().is_some_and(|status| status.armed);
        let when = if in_flight { "in flight" } else { "before the flight" };
        match next_status(&mut processes.simulator, &processes.statuses, when)? {
            Some(status) => {
                silent_looks = 0;
                terminal.show(&bar, &flight.path, &status);
                flight.keep(status);
            }
            None => {
                silent_looks += 1;
                let (name, limit_s) = (processes.simulator.name, (LOOK * SILENT_LOOKS).as_secs());
                ensure!(silent_looks < SILENT_LOOKS, "the {name} said nothing for {limit_s} s");
            }
        }
        processes.firmware.check_when(when)?;
        // One that ends in flight leaves the firmware holding, and is named at the end.
        if let Some(adversary) = processes.adversary.as_mut().filter(|_| !has_flown) {
            adversary.check_when(when)?;
        }
        let Some(status) = &flight.last else { continue };
        if is_pose_lost(status, &mut no_pose_since)? {
            break;
        }
        if let Some(advice) = pilot.observe(status).filter(|_| !is_quiet) {
            bar.suspend(|| say!("{advice}"));
        }
        match status.outcome {
            Some(Outcome::Success) => {
                if !status.armed || held_for(&mut reached_at, true) > LANDING_LIMIT {
                    break;
                }
            }
            Some(_) => break,
            None => {
                has_flown |= status.armed && status.position_ned_m[2] < -flies_m;
                let landed = has_flown && !status.armed && status.position_ned_m[2] > -flies_m;
                if held_for(&mut disarmed_at, landed) > DISARMED_LIMIT {
                    let away_m = status.goal_distance_m;
                    if !is_quiet {
                        bar.suspend(|| say!("landed     the vehicle landed and disarmed {away_m:.1} m from the goal"));
                    }
                    break;
                }
            }
        }
    }
    bar.finish_and_clear();
    Ok(())
}
