//! Plans: what a ground station uploads by the mission protocol. There are three kinds, each a list of items: the mission,
//! the geofence and the rally points. <https://mavlink.io/en/services/mission.html>

mod fence;
mod item;
pub(crate) mod mission;
mod rally;

pub(crate) use fence::{Fence, is_empty_circle};
pub(crate) use item::{Envelope, Place, PlanItem};
pub(crate) use mission::{Leg, Mission, MissionItem, Purpose, Stage};
pub(crate) use rally::Rally;

use crate::used_parameters::misused_in_item;
use vigil_mavlink::common::MavMissionResult;

vigil_types::named! {
    /// The kinds of plan, by their MAV_MISSION_TYPE.
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    pub(crate) enum PlanKind {
        Mission => "mission",
        Fence => "geofence",
        Rally => "rally points",
    }
}

impl PlanKind {
    /// Reads a MAV_MISSION_TYPE.
    pub fn from_number(number: u8) -> Option<Self> {
        Self::ALL.get(usize::from(number)).copied()
    }

    /// Most items of a plan.
    pub const fn capacity(self) -> u16 {
        [1000, 200, 32][self as usize]
    }
}

/// Why an item or a plan is refused.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct PlanDefect {
    pub result: MavMissionResult,
    /// For the status text.
    pub reason: &'static str,
}

impl PlanDefect {
    pub const fn new(result: MavMissionResult, reason: &'static str) -> Self {
        Self { result, reason }
    }

    pub const fn unsupported(reason: &'static str) -> Self {
        Self::new(MavMissionResult::MAV_MISSION_UNSUPPORTED, reason)
    }

    /// Of the parameter of this number, 1 to 7.
    pub const fn of_parameter(number: usize, reason: &'static str) -> Self {
        use MavMissionResult as R;
        let result = match number {
            1 => R::MAV_MISSION_INVALID_PARAM1,
            2 => R::MAV_MISSION_INVALID_PARAM2,
            3 => R::MAV_MISSION_INVALID_PARAM3,
            4 => R::MAV_MISSION_INVALID_PARAM4,
            5 => R::MAV_MISSION_INVALID_PARAM5_X,
            6 => R::MAV_MISSION_INVALID_PARAM6_Y,
            _ => R::MAV_MISSION_INVALID_PARAM7,
        };
        Self::new(result, reason)
    }
}

/// The items of a plan as they came, and the plan's id.
#[derive(Debug, Default, Clone, PartialEq)]
pub(crate) struct Wire {
    pub items: Vec<PlanItem>,
    /// The `opaque_id`: equal for equal items, 0 for none.
    pub id: u32,
}

impl Wire {
    pub fn new(items: Vec<PlanItem>) -> Self {
        // FNV-1a, 32 bits.
        let hash = |hash: u32, byte: u8| (hash ^ u32::from(byte)).wrapping_mul(0x0100_0193);
        let id = items.iter().flat_map(PlanItem::content).fold(0x811C_9DC5, hash);
        Self {
            id: if items.is_empty() { 0 } else { id.max(1) },
            items,
        }
    }
}

/// The three plans in force.
#[derive(Debug, Default)]
pub(crate) struct Plans {
    pub mission: Mission,
    pub fence: Fence,
    pub rally: Rally,
    wires: [Wire; 3],
}

impl Plans {
    /// Whether a plan of this kind can be made with an item.
    pub fn read(kind: PlanKind, item: &PlanItem) -> Result<(), PlanDefect> {
        match kind {
            PlanKind::Mission => MissionItem::read(item).map(|_| ()),
            PlanKind::Fence => Fence::check(item),
            PlanKind::Rally => Rally::read(item).map(|_| ()),
        }
    }

    /// Whether an item may be part of a plan of this kind.
    pub fn check(kind: PlanKind, item: &PlanItem) -> Result<(), PlanDefect> {
        Self::read(kind, item)?;
        let misused = misused_in_item(item.command, item.params, item.x, item.y, item.z);
        let defect = |number| Err(PlanDefect::of_parameter(number, "a parameter that has no meaning"));
        misused.map_or(Ok(()), defect)
    }

    /// Puts a plan in the place of the one of its kind, which stays as it is if the new one is refused.
    pub fn replace(&mut self, kind: PlanKind, items: Vec<PlanItem>) -> Result<(), PlanDefect> {
        match kind {
            PlanKind::Mission => self.mission = Mission::new(&items)?,
            PlanKind::Fence => self.fence = Fence::new(&items)?,
            PlanKind::Rally => self.rally = Rally::new(&items)?,
        }
        self.wires[kind as usize] = Wire::new(items);
        Ok(())
    }

    /// Whether the mission pauses after the current item.
    pub fn mission_pauses(&self) -> bool {
        let item = self
            .wire(PlanKind::Mission)
            .items
            .get(usize::from(self.mission.current()));
        item.is_some_and(|item| item.autocontinue == 0)
    }

    /// The items of a plan as they came.
    pub fn wire(&self, kind: PlanKind) -> &Wire {
        &self.wires[kind as usize]
    }
}
