//! A mission of the vehicle's own, for flights that Vigil only guards.

use crate::ground::{STATION, packet, set_auto_mode};
use std::path::{Path, PathBuf};
use vigil_autopilot::Saved;
use vigil_autopilot::geo::to_global;
use vigil_mavlink::common::{MavCmd, MavFrame};
use vigil_mavlink::message;
use vigil_sim::SimConfig;
use vigil_types::NedVector;

/// The vehicle's plan at so many metres per second: by way of these places, metres north and east, to the goal; with the nose towards the
/// next, or always this way, degrees from north.
pub fn plan(config: &SimConfig, speed_m_s: f32, via_m: &[(f32, f32)], nose_deg: Option<f32>) -> Saved {
    let goal = config.course.goal_ned_m();
    let nose = nose_deg.map_or("nan".to_owned(), |deg| format!("{deg:?}"));
    let mut text = format!("[parameters]\nMPC_XY_CRUISE = {speed_m_s:?}\n");
    for (north_m, east_m) in via_m.iter().copied().chain([(goal.x, goal.y)]) {
        let (x, y, _) = to_global(NedVector::new(north_m, east_m, 0.0));
        text += &format!(
            "[[mission]]\ncommand = 16\nframe = 6\nautocontinue = 1\nparams = [0.0, 0.0, 0.0, {nose}]\n\
             x = {x}\ny = {y}\nz = {:?}\n",
            -goal.z
        );
    }
    vigil_types::settings::from_toml(&text).expect("a plan")
}

/// A course's file: open ground, the goal so far straight ahead, and what stands there.
pub fn straight_course(folder: &Path, goal_m: f32, solids: &str) -> PathBuf {
    let path = folder.join("straight.toml");
    let text = format!(
        "name = \"straight\"\ngoal = {{ north_m = {goal_m}, east_m = 0.0 }}\n\
         bounds = {{ north_m = [-10.0, 30.0], east_m = [-20.0, 20.0], top_m = 12.0 }}\n{solids}"
    );
    std::fs::write(&path, text).expect("written");
    path
}

/// A command of a ground station: fly the mission.
pub fn start() -> Vec<u8> {
    packet(STATION, 0, &set_auto_mode(4.0))
}

/// A command of a ground station: go to the course's goal, which leaves the vehicle in hold.
pub fn go_to(config: &SimConfig) -> Vec<u8> {
    let (x, y, above_sea_m) = to_global(config.course.goal_ned_m());
    let message = message!(
        COMMAND_INT,
        command = MavCmd::MAV_CMD_DO_REPOSITION,
        frame = MavFrame::MAV_FRAME_GLOBAL,
        param1 = -1.0,
        param2 = 1.0,
        param4 = f32::NAN,
        x,
        y,
        z = above_sea_m as f32,
        target_system = 1,
        target_component = 1
    );
    packet(STATION, 0, &message)
}
