//! The mission: what its items mean, and how far it is done. How it is flown is `flight::mission`.

use crate::core::nanos;
use crate::plan::{Place, PlanDefect, PlanItem};
use vigil_mavlink::common::{MavMissionResult, MissionState};
use vigil_types::Nanos;

const NAV_WAYPOINT: u16 = 16;
const NAV_LOITER_UNLIM: u16 = 17;
const NAV_LOITER_TIME: u16 = 19;
pub(crate) const NAV_RETURN_TO_LAUNCH: u16 = 20;
pub(crate) const NAV_LAND: u16 = 21;
pub(crate) const NAV_TAKEOFF: u16 = 22;
const NAV_LOITER_TO_ALT: u16 = 31;
pub(crate) const NAV_ROI: u16 = 80;
const NAV_DELAY: u16 = 93;
const CONDITION_DELAY: u16 = 112;
const DO_JUMP: u16 = 177;
pub(crate) const DO_CHANGE_SPEED: u16 = 178;
pub(crate) const DO_SET_HOME: u16 = 179;
pub(crate) const DO_SET_ROI_LOCATION: u16 = 195;
pub(crate) const DO_SET_ROI_NONE: u16 = 197;
pub(crate) const DO_SET_ROI: u16 = 201;
/// MAV_ROI_LOCATION.
pub(crate) const ROI_LOCATION: f32 = 3.0;
/// Taken for the sake of plans that carry them, and passed over, because the vehicle has nothing that they command. A region
/// of interest at the next item is where the nose is anyway, and the motors are the landing's and the pilot's to stop.
const PASSED_OVER: [u16; 26] = [
    // Conditions on what comes next: a distance, a gate. Actuators, gripper, winch, a VTOL's transition.
    114, 4501, 187, 211, 42600, 3000,
    // Where a landing begins; a region of interest at the next item; a survey by slanted pictures; arming.
    189, 196, 260, 400, // Cameras: control, triggers, modes, pictures, video.
    200, 203, 206, 214, 530, 532, 534, 2000, 2001, 2003, 2500, 2501, // Gimbals: mounts and managers.
    204, 205, 1000, 1001,
];
/// Commands that PX4 takes in a global frame, and those of them that it takes without a frame (2) too; the others it takes so only.
const IN_GLOBAL_FRAMES: [u16; 11] = [16, 17, 19, 21, 22, 31, 80, 195, 201, 400, 4501];
const IN_EITHER: [u16; 3] = [80, 201, 400];
const FRAME_MISSION: u8 = 2;
const UNKNOWN: PlanDefect = PlanDefect::unsupported("not a command that missions fly");
/// A longer wait is a mistake.
const MAX_WAIT_S: f32 = 86_400.0;

/// What is to happen at a place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Purpose {
    /// Fly there, and stay this long; the longest time is for good.
    Visit { stay_ns: Nanos },
    /// Climb straight up first.
    TakeOff,
    /// Descend there.
    Land,
}

/// A flight to a place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Leg {
    pub place: Place,
    /// Heading there; `None` is "towards the place".
    pub yaw_rad: Option<f32>,
    /// Distance at which the place is reached; `None` is NAV_ACC_RAD.
    pub acceptance_m: Option<f32>,
    pub purpose: Purpose,
}

/// What an item means.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum MissionItem {
    Leg(Leg),
    /// Return mode.
    Return,
    /// Wait where it is for so long.
    Delay(Nanos),
    /// Fly at this speed from here on, metres per second; `None` is MPC_XY_CRUISE.
    Speed(Option<f32>),
    /// Go on with another item; `None` is without end.
    Jump {
        to: usize,
        times: Option<u16>,
    },
    /// Point the nose there from here on, metres north and east; `None` is along the way again.
    Interest(Option<(f32, f32)>),
    /// Home is from here on where the vehicle is.
    Home,
    /// Nothing that this vehicle does.
    PassedOver,
}

fn seconds(item: &PlanItem) -> Result<Nanos, PlanDefect> {
    let wait_s = item.param(1).unwrap_or(0.0);
    nanos(f64::from(wait_s))
        .filter(|_| wait_s <= MAX_WAIT_S)
        .ok_or(PlanDefect::of_parameter(1, "time is not within 0 and 86400 s"))
}

/// A heading in degrees, in radians.
fn heading_rad(item: &PlanItem, number: usize) -> Result<Option<f32>, PlanDefect> {
    match item.param(number) {
        None => Ok(None),
        Some(deg) if deg.abs() <= 720.0 => Ok(Some(deg.to_radians())),
        Some(_) => Err(PlanDefect::of_parameter(number, "heading is not within 720 degrees")),
    }
}

fn check_frame(item: &PlanItem, is_known: bool) -> Result<(), PlanDefect> {
    use MavMissionResult as R;
    let is_placed = IN_GLOBAL_FRAMES.contains(&item.command);
    match item.frame {
        0 | 3 | 5 | 6 if is_placed => Ok(()),
        FRAME_MISSION if !is_placed || IN_EITHER.contains(&item.command) => Ok(()),
        0 | 3 | 5 | 6 | FRAME_MISSION if !is_known => Err(UNKNOWN),
        0 | 3 | 5 | 6 | FRAME_MISSION => Err(PlanDefect::unsupported("not a command that missions fly in this frame")),
        _ => Err(PlanDefect::new(R::MAV_MISSION_UNSUPPORTED_FRAME, "frame is not global")),
    }
}

impl MissionItem {
    /// Reads an item.
    pub fn read(item: &PlanItem) -> Result<Self, PlanDefect> {
        let meaning = Self::meaning(item);
        check_frame(item, meaning != Err(UNKNOWN))?;
        meaning
    }

    /// What it means in the frames of its command.
    fn meaning(item: &PlanItem) -> Result<Self, PlanDefect> {
        let leg = |place, yaw_rad, acceptance_m, purpose| {
            Ok(Self::Leg(Leg {
                place,
                yaw_rad,
                acceptance_m,
                purpose,
            }))
        };
        let to = |purpose| leg(item.place()?, heading_rad(item, 4)?, None, purpose);
        let stay = |stay_ns| Purpose::Visit { stay_ns };
        let look_at = |place_m| Ok(Self::Interest(place_m));
        let misused = |reason| Err(PlanDefect::of_parameter(1, reason));
        match item.command {
            NAV_WAYPOINT => {
                let radius_m = item.param(2).unwrap_or(0.0);
                if !(0.0..=1000.0).contains(&radius_m) {
                    return Err(PlanDefect::of_parameter(2, "acceptance radius"));
                }
                item.point()?;
                let (acceptance_m, visit) = ((radius_m > 0.0).then_some(radius_m), stay(seconds(item)?));
                leg(item.place()?, heading_rad(item, 4)?, acceptance_m, visit)
            }
            NAV_LOITER_UNLIM => to(stay(Nanos::MAX)),
            NAV_LOITER_TIME => to(stay(seconds(item)?)),
            // Parameter 4 is not a heading here.
            NAV_LOITER_TO_ALT => leg(item.place()?, None, None, stay(0)),
            // Where the ground is, is not the item's to say.
            NAV_LAND => {
                let north_east_m = item.north_east_m()?;
                let place = Place {
                    north_east_m,
                    height_m: None,
                };
                leg(place, heading_rad(item, 4)?, None, Purpose::Land)
            }
            NAV_TAKEOFF => to(Purpose::TakeOff),
            NAV_RETURN_TO_LAUNCH => Ok(Self::Return),
            // A mission's command in a frame without places.
            DO_SET_HOME if item.param(1) == Some(1.0) => Ok(Self::Home),
            DO_SET_HOME => misused("a mission sets home only where the vehicle is"),
            NAV_DELAY | CONDITION_DELAY => Ok(Self::Delay(seconds(item)?)),
            DO_CHANGE_SPEED => Self::speed(item),
            DO_JUMP => Self::jump(item),
            DO_SET_ROI_LOCATION => look_at(Some(item.point()?)),
            DO_SET_ROI_NONE => look_at(None),
            NAV_ROI | DO_SET_ROI => match item.param(1) {
                Some(ROI_LOCATION) => look_at(Some(item.point()?)),
                None | Some(0.0) => look_at(None),
                // A waypoint, without a frame only: the nose points there anyway.
                Some(1.0 | 2.0) if item.frame == FRAME_MISSION => look_at(None),
                Some(_) => misused("no such region of interest"),
            },
            command if PASSED_OVER.contains(&command) => Ok(Self::PassedOver),
            _ => Err(UNKNOWN),
        }
    }

    fn speed(item: &PlanItem) -> Result<Self, PlanDefect> {
        // Rates of climb and descent are parameters.
        if item.param(1).is_some_and(|kind| kind >= 2.0) {
            return Ok(Self::PassedOver);
        }
        match item.param(2) {
            Some(speed) if speed > 0.0 && speed <= 50.0 => Ok(Self::Speed(Some(speed))),
            // −1: no change; −2: back to the default, as is whatever is left out.
            Some(-1.0) => Ok(Self::PassedOver),
            None | Some(-2.0) => Ok(Self::Speed(None)),
            Some(_) => Err(PlanDefect::of_parameter(2, "speed is not within 0 and 50 m/s")),
        }
    }

    fn jump(item: &PlanItem) -> Result<Self, PlanDefect> {
        let to = item.param(1).filter(|p| (0.0..=65535.0).contains(p));
        let times = item.param(2).filter(|p| (-1.0..=65535.0).contains(p));
        match (to, times) {
            (Some(to), Some(times)) => Ok(Self::Jump {
                to: to as usize,
                times: (times >= 0.0).then_some(times as u16),
            }),
            (None, _) => Err(PlanDefect::of_parameter(1, "no such item to jump to")),
            (_, None) => Err(PlanDefect::of_parameter(2, "number of jumps")),
        }
    }
}

/// How far the current item is done.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) enum Stage {
    /// To be begun.
    #[default]
    Fresh,
    /// Climbing before the way to the place.
    Climbing,
    /// On the way.
    Travelling,
    /// Waiting until this time.
    Waiting { until_ns: Nanos },
    /// Descending.
    Landing,
}

/// The mission and its progress.
#[derive(Debug, Default)]
pub(crate) struct Mission {
    items: Vec<MissionItem>,
    /// How often each item has jumped.
    jumped: Vec<u16>,
    current: usize,
    /// The item that was reached last.
    pub reached: Option<u16>,
    is_started: bool,
    is_complete: bool,
    /// How far the current item is done.
    pub stage: Stage,
    /// The next item begins no sooner: items that take no time must not flood the links.
    pub not_before_ns: Nanos,
    /// Speed that an item of the mission has set.
    pub speed_m_s: Option<f32>,
    /// Velocity north and east with which the present place is passed; zero to stop there.
    pub passing_m_s: (f32, f32),
}

impl Mission {
    pub fn new(items: &[PlanItem]) -> Result<Self, PlanDefect> {
        let read = items.iter().map(MissionItem::read);
        let meanings = read.collect::<Result<Vec<_>, _>>()?;
        let astray = |item: &MissionItem| matches!(item, MissionItem::Jump { to, .. } if *to >= meanings.len());
        if meanings.iter().any(astray) {
            return Err(PlanDefect::of_parameter(1, "no such item to jump to"));
        }
        Ok(Self {
            jumped: vec![0; meanings.len()],
            items: meanings,
            ..Self::default()
        })
    }

    pub fn len(&self) -> usize {
        self.items.len()
    }

    pub fn is_empty(&self) -> bool {
        self.items.is_empty()
    }

    /// Index of the current item.
    pub fn current(&self) -> u16 {
        self.current as u16
    }

    /// Index of the item with which it begins or goes on.
    pub fn goes_on_with(&self) -> u16 {
        if self.is_complete { 0 } else { self.current() }
    }

    /// The current item.
    pub fn item(&self) -> Option<MissionItem> {
        self.items.get(self.current).copied()
    }

    /// Where the next way leads, in metres north and east, if nothing that takes time comes before it.
    pub fn next_place_m(&self) -> Option<(f32, f32)> {
        let after = self.items.get(self.current + 1..)?;
        use MissionItem::{Home, Interest, PassedOver, Speed};
        let takes_time = |item: &&MissionItem| !matches!(item, PassedOver | Interest(_) | Speed(_) | Home);
        match after.iter().find(takes_time)? {
            MissionItem::Leg(leg) => leg.place.north_east_m,
            _ => None,
        }
    }

    /// All flights with their index.
    pub fn legs(&self) -> impl Iterator<Item = (usize, &Leg)> {
        self.items.iter().enumerate().filter_map(|(i, item)| match item {
            MissionItem::Leg(leg) => Some((i, leg)),
            _ => None,
        })
    }

    /// State as MISSION_CURRENT has it; `is_flown` says whether the vehicle is in mission mode.
    pub fn state(&self, is_flown: bool) -> MissionState {
        if self.is_empty() {
            MissionState::MISSION_STATE_NO_MISSION
        } else if self.is_complete {
            MissionState::MISSION_STATE_COMPLETE
        } else if is_flown {
            MissionState::MISSION_STATE_ACTIVE
        } else if self.is_started {
            MissionState::MISSION_STATE_PAUSED
        } else {
            MissionState::MISSION_STATE_NOT_STARTED
        }
    }

    /// Begins or goes on: from the current item, or from the first if the mission was complete.
    pub fn start(&mut self) {
        if self.is_complete {
            self.rewind();
        }
        self.is_started = true;
        self.stage = Stage::Fresh;
    }

    fn rewind(&mut self) {
        self.jumped.fill(0);
        self.current = 0;
        self.reached = None;
        self.is_complete = false;
        self.is_started = false;
        self.speed_m_s = None;
        self.stage = Stage::Fresh;
    }

    /// Makes an item the current one; `false` if there is no such item.
    pub fn set_current(&mut self, index: usize) -> bool {
        if index >= self.items.len() {
            return false;
        }
        if self.is_complete {
            self.rewind();
        }
        self.current = index;
        self.stage = Stage::Fresh;
        true
    }

    /// The current item is done: goes on to the next; `false` if it was the last. `is_reached` says whether it counts as
    /// reached.
    pub fn advance(&mut self, is_reached: bool) -> bool {
        if is_reached {
            self.reached = Some(self.current());
        }
        self.stage = Stage::Fresh;
        let next = match (self.item(), self.jumped.get_mut(self.current)) {
            (Some(MissionItem::Jump { to, times }), Some(jumped)) if times.is_none_or(|times| *jumped < times) => {
                *jumped = jumped.saturating_add(1);
                to
            }
            (_, jumped) => {
                // Passed by, it jumps again when it is come to once more.
                jumped.into_iter().for_each(|times| *times = 0);
                self.current + 1
            }
        };
        self.is_complete = next >= self.items.len();
        if !self.is_complete {
            self.current = next;
        }
        !self.is_complete
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::plans::{action, waypoint};

    #[test]
    fn a_jump_is_taken_as_often_as_it_says_and_again_when_come_to_again() {
        let there = waypoint((1.0, 0.0), 5.0);
        let jump = |times: f32| action(177, [0.0, times, 0.0, 0.0]);
        let items = vec![there, jump(2.0), there, jump(1.0)];
        let mut mission = Mission::new(&items).expect("valid");
        mission.start();
        let mut visited = vec![mission.current()];
        while mission.advance(true) {
            visited.push(mission.current());
        }
        assert_eq!(visited, [0, 1, 0, 1, 0, 1, 2, 3, 0, 1, 0, 1, 0, 1, 2, 3]);
        assert_eq!(mission.state(false), MissionState::MISSION_STATE_COMPLETE);
        mission.start();
        assert_eq!((mission.current(), mission.reached), (0, None));
    }

    #[test]
    fn a_speed_can_go_back_to_its_default() {
        let read = |i: PlanItem| MissionItem::read(&i).expect("valid");
        let default = MissionItem::Speed(None);
        assert_eq!(read(action(178, [1.0, -2.0, -1.0, 0.0])), default);
        assert_eq!(read(action(178, [1.0, -1.0, -1.0, 0.0])), MissionItem::PassedOver);
        assert_eq!(read(action(178, [3.0, 2.0, -1.0, 0.0])), MissionItem::PassedOver);
    }
}
