//! Goals farther away than any that the actor has learned.

use vigil_firmware::FirmwareConfig;
use vigil_sim::world::{Course, Outcome};
use vigil_tests::{airborne, ended, fly_monitored, refused, run, run_line};
use vigil_types::{GuidanceState, PilotKind, Reason, StepReport};

/// Columns in the way, and a screen that has to be passed at its side.
const COURSE: &str = r#"
name = "far goal"
start = { heading_deg = 20.0 }
goal = { north_m = 110.0, east_m = -4.0 }
bounds = { north_m = [-4.0, 116.0], east_m = [-9.0, 9.0], top_m = 6.0 }
time_limit_s = 200.0

[[column]]
north_m = 12.0
east_m = -0.4
radius_m = 0.4
height_m = 4.0

[[column]]
north_m = 60.0
east_m = -2.2
radius_m = 0.4
height_m = 4.0

[[wall]]
from_m = [35.0, -4.0]
to_m = [35.0, 1.5]
thickness_m = 0.2
height_m = 3.0
"#;

/// How a flight of the actor alone ended, and its reports.
fn fly(course: &str, change: impl FnOnce(&mut FirmwareConfig)) -> (Option<Outcome>, Vec<StepReport>) {
    let course = Course::from_toml_str(course, "course of a test").expect("a course");
    fly_monitored(&airborne(course, 11), |config| {
        config.pilot.apf = false;
        change(config);
    })
}

#[test]
fn the_actor_alone_arrives_at_a_goal_110_m_away_and_stays_within_the_course() {
    let (outcome, reports) = fly(COURSE, |_| {});
    assert_eq!(outcome, Some(Outcome::Success));
    let told_m = (reports.iter().find_map(|r| r.goal_relative))
        .expect("a goal")
        .distance_m;
    assert!(told_m > 109.0, "what is sent is the goal itself: {told_m} m");
}

/// A hall with no way out.
fn closed() -> String {
    let corners = [[-4.0, -6.0], [7.0, -6.0], [7.0, 6.0], [-4.0, 6.0], [-4.0, -6.0]];
    let wall = |ends: &[[f32; 2]]| {
        let [from, to] = [ends[0], ends[1]];
        format!("[[wall]]\nfrom_m = {from:?}\nto_m = {to:?}\nthickness_m = 0.2\nheight_m = 5.0\n")
    };
    "name = \"closed\"\ngoal = { north_m = 20.0, east_m = 0.0 }\ntime_limit_s = 60.0\n\
     bounds = { north_m = [-8.0, 25.0], east_m = [-9.0, 9.0], top_m = 6.0 }\n"
        .to_owned()
        + &corners.windows(2).map(wall).collect::<String>()
}

#[test]
fn a_flight_that_cannot_get_nearer_is_ended_by_name_on_the_ground() {
    let (outcome, reports) = fly(&closed(), |config| {
        config.pilot.kind = PilotKind::Geometric;
        config.limits.no_progress_s = 20.0;
    });
    assert_eq!(outcome, Some(Outcome::TimeOut), "it landed, and nothing was hit");
    let held = reports.iter().find(|r| r.state == GuidanceState::Hold).expect("a hold");
    assert!(held.reasons.contains(Reason::NoProgress), "{:?}", held.reasons);
    assert!(reports.iter().any(|r| r.state == GuidanceState::Land));
}

#[test]
fn distances_that_no_course_has_are_refused_with_what_is_allowed() {
    for (arguments, part) in [
        (["--goal-distance", "900"], "from 5 to 400 metres"),
        (["--goal-distance", "300..30"], "nearer distance comes first"),
        (["--goal-distance", "far"], "150 or 30..300"),
    ] {
        let evaluated = run(&[&["evaluate", "--flights", "1"][..], &arguments].concat());
        ended(&evaluated, 2, &[part]);
    }
    let write = "courses write --seed 3 --goal-distance 90";
    let hard = run_line(&format!("{write} --family hard"));
    refused(&hard, &["hard cannot be made longer"]);
    let output = run_line(write);
    let course = Course::from_toml_str(&String::from_utf8_lossy(&output.stdout), "written").expect("a course");
    assert_eq!(course.goal.north_m, 90.0);
}
