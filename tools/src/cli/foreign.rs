//! `vigil fly` around a vehicle that already runs: PX4's or ArduPilot's own simulation, or a hardware-in-the-loop rig.

use anyhow::{Result, ensure};
use std::process::Command;
use std::time::{Duration, Instant};
use vigil_firmware::arguments::choice;
use vigil_io::gate::AllowUnsigned;
use vigil_io::link_spec::LinkSpec;
use vigil_sim::foreign::PoseState;
use vigil_sim::program::Status;
use vigil_types::{AutopilotChoice, Choice, GuidanceState, Reason};

/// Where the firmware passes on to the sensor what it hears of the vehicle, of instance 0.
const POSE_PORT: u32 = 14130;
/// A vehicle whose pose cannot be rendered for so long is given up.
const NO_POSE_LIMIT: Duration = Duration::from_secs(30);

/// How long a vehicle may be its pilot's before somebody reads what to do.
const PILOT_PATIENCE: Duration = Duration::from_secs(3);

/// The foreign vehicle.
#[derive(Debug, Clone, clap::Args)]
pub struct ForeignArgs {
    /// Fly a vehicle that already runs, instead of the simulated one: px4, ardupilot, or auto, which recognises it.
    #[arg(long, requires = "link", value_parser = choice::<AutopilotChoice>())]
    pub vehicle: Option<AutopilotChoice>,

    /// Where that vehicle's MAVLink is: a URL as of `vigil firmware --link`. The pose is heard there too.
    #[arg(long, value_name = "URL[,OPTION]", requires = "vehicle")]
    pub link: Option<LinkSpec>,

    /// A further link on which the sensor hears that vehicle's pose, sooner than through the firmware. May be repeated.
    #[arg(long, value_name = "URL[,OPTION]", requires = "link")]
    pub pose: Vec<LinkSpec>,

    /// Render and referee that vehicle's true pose (HIL_STATE_QUATERNION); for simulators that send it.
    #[arg(long, requires = "link")]
    pub truth: bool,

    /// From whom on that vehicle's links packets without a signature are accepted: from this machine, nobody, everybody.
    #[arg(long, value_enum, value_name = "WHO", requires = "link")]
    pub allow_unsigned: Option<AllowUnsigned>,
}

impl ForeignArgs {
    /// Whether the vehicle is one that already runs.
    pub fn is_foreign(&self) -> bool {
        self.link.is_some()
    }

    fn hand_on(&self, command: &mut Command) {
        if let Some(who) = self.allow_unsigned {
            command.args(["--allow-unsigned", who.name()]);
        }
    }

    /// Arguments of the firmware on that vehicle: its link, and the one on which the sensor listens.
    pub fn firmware(&self, command: &mut Command, instance: u32) {
        let (Some(vehicle), Some(link)) = (self.vehicle, &self.link) else {
            return;
        };
        command.args(["--vehicle", vehicle.name(), "--link", &link.to_string()]);
        command
            .arg("--link")
            .arg(format!("udpout://127.0.0.1:{}", POSE_PORT + instance));
        self.hand_on(command);
    }

    /// Arguments of the sensor around that vehicle.
    pub fn sensor(&self, command: &mut Command, instance: u32) {
        let system = self.link.as_ref().and_then(|link| link.system);
        let option = system.map_or(String::new(), |id| format!(",system={id}"));
        command.args(["sensor", "render", "--pose"]);
        command.arg(format!("udpin://127.0.0.1:{}{option}", POSE_PORT + instance));
        for link in &self.pose {
            command.arg("--pose").arg(link.to_string());
        }
        if self.truth {
            command.arg("--truth");
        }
        self.hand_on(command);
    }

    /// The vehicle in a flight's log.
    pub fn in_words(&self) -> Option<String> {
        let (vehicle, link) = (self.vehicle?, self.link.as_ref()?);
        Some(format!("{} on {link}", vehicle.name()))
    }
}

/// For how long something has held without a break; zero where it does not hold now.
pub fn held_for(since: &mut Option<Instant>, holds: bool) -> Duration {
    *since = since.or_else(|| Some(Instant::now())).filter(|_| holds);
    since.map_or(Duration::ZERO, |at| at.elapsed())
}

/// Whether the pose is lost for good, which ends the flight without a verdict.
///
/// # Errors
/// No pose for half a minute, with what is missing and what to do.
pub fn is_pose_lost(status: &Status, missing_since: &mut Option<Instant>) -> Result<bool> {
    let state = status.pose.as_deref().filter(|_| status.outcome.is_none());
    let missing = held_for(missing_since, state.is_some());
    let Some(state) = state else { return Ok(false) };
    let is_final = PoseState::from_name(state).is_some_and(PoseState::is_final);
    let limit_s = NO_POSE_LIMIT.as_secs();
    ensure!(
        is_final || missing <= NO_POSE_LIMIT,
        "{state}, for {limit_s} s: `vigil doctor --link URL` says what is missing (docs/foreign-vehicles.md)"
    );
    Ok(is_final)
}

/// Says once what to do with a vehicle that its pilot has: guidance arms nothing in a mode that somebody may fly by sticks.
#[derive(Default)]
pub struct PilotWatch {
    waits_since: Option<Instant>,
    was_guided: bool,
    is_said: bool,
}

impl PilotWatch {
    /// Looks at a status; what to tell, if it is time to.
    pub fn observe(&mut self, status: &Status) -> Option<String> {
        self.was_guided |= status.guidance.as_deref() == Some(GuidanceState::Guided.name());
        let mut reasons = status.reasons.iter();
        let waits = !self.is_said && reasons.any(|reason| reason == Reason::PilotInCommand.name());
        if held_for(&mut self.waits_since, waits) < PILOT_PATIENCE {
            return None;
        }
        self.is_said = true;
        let change = match status.mode.as_str() {
            // Who took it over in flight gives it back by an engage alone.
            _ if self.was_guided => "",
            "hold" => "",
            _ if status.armed => "change it to GUIDED (ArduPilot) when it may go, or ",
            _ => "change it to GUIDED (ArduPilot) or Hold (PX4) when it may go, or ",
        };
        Some(format!(
            "waiting    the vehicle is in its pilot's mode {}: {change}engage from a ground station (docs/guidance.md, \"Where auto engages\")",
            status.mode
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_vehicle_that_was_taken_over_is_not_sent_to_a_mode_that_gives_nothing_back() {
        let advice = |was_guided, armed| {
            let mut status = Status::default();
            (status.armed, status.reasons) = (armed, vec![Reason::PilotInCommand.name().to_owned()]);
            let mut watch = PilotWatch::default();
            (watch.was_guided, watch.waits_since) = (was_guided, Some(Instant::now() - PILOT_PATIENCE));
            let text = watch.observe(&status).expect("it waited");
            ["GUIDED", "Hold", "engage from"].map(|word| text.contains(word))
        };
        let all = [(false, false), (false, true), (true, true)].map(|(guided, armed)| advice(guided, armed));
        assert_eq!(all, [[true; 3], [true, false, true], [false, false, true]]);
    }
}
