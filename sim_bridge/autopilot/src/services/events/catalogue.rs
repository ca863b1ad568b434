//! The events there are: their numbers, their arguments, and their definitions for clients.
//! Format: <https://github.com/mavlink/libevents>.

use crate::core::padded;
use crate::flight::{Denial, Failsafe, FlightMode};
use serde_json::{Map, Value, json};

/// Upper byte of an event's number: the autopilot's name space.
const COMPONENT: u32 = 1 << 24;
/// All modes share the same checks.
const MODE_GROUP: u32 = 1;
/// Bit 0 of the health components: none of them.
const HEALTH_NONE: u32 = 0;
const BATTERY_BIT: u32 = 1 << 4;
const PRESENT: u32 = 0b1_1110;
/// Numbers of the events that sum others up; the failed checks follow the first.
const CHECK_SUMMARY: u32 = 100;
const HEALTH_SUMMARY: u32 = 200;

vigil_types::named! {
    /// Why the vehicle cannot be armed.
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    pub(super) enum ArmingCheck {
        Terminated => "check_terminated",
        Tilted => "check_tilted",
        OutsideFence => "check_outside_fence",
        Other => "check_other",
        SensorLost => "check_sensor_lost",
    }
}

impl From<&Denial> for ArmingCheck {
    fn from(denial: &Denial) -> Self {
        match denial {
            Denial::Terminated(_) => Self::Terminated,
            Denial::Tilted => Self::Tilted,
            Denial::OutsideFence => Self::OutsideFence,
            Denial::SensorLost(_) => Self::SensorLost,
            _ => Self::Other,
        }
    }
}

impl ArmingCheck {
    /// Index of the health component it concerns, and its text.
    fn component_and_message(self) -> (u8, &'static str) {
        match self {
            Self::Terminated => (1, "Flight was terminated: reboot first"),
            Self::Tilted => (2, "Vehicle is tilted"),
            Self::OutsideFence => (3, "Vehicle is outside its geofence"),
            Self::SensorLost => (1, "A sensor is lost"),
            Self::Other => (1, "Vehicle is not ready"),
        }
    }
}

/// What can be reported.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Event {
    Armed,
    Disarmed,
    ModeChanged(FlightMode),
    FailsafeEntered(Failsafe),
    FailsafeEnded,
    Terminated,
    TookOff,
    Landed,
    /// With the check that fails.
    ArmingCheckSummary(Option<ArmingCheck>),
    CheckFailed(ArmingCheck),
    HealthSummary,
}

impl Event {
    pub(super) fn id(self) -> u32 {
        COMPONENT | self.row().0
    }

    /// Its number below the component's, name, message, and arguments by type and name.
    fn row(self) -> (u32, &'static str, &'static str, &'static str) {
        match self {
            Self::Armed => (1, "armed", "Armed", ""),
            Self::Disarmed => (2, "disarmed", "Disarmed", ""),
            Self::ModeChanged(_) => (3, "mode_changed", "Mode: {1}", "flight_mode_t mode"),
            Self::FailsafeEntered(_) => (4, "failsafe_entered", "Failsafe: {1}", "failsafe_t failsafe"),
            Self::FailsafeEnded => (5, "failsafe_ended", "Failsafe ended", ""),
            Self::Terminated => (6, "terminated", "Flight terminated", ""),
            Self::TookOff => (7, "took_off", "Took off", ""),
            Self::Landed => (8, "landed", "Landed", ""),
            Self::ArmingCheckSummary(_) => {
                let arguments = "uint8_t chunk_idx, health_component_t error, health_component_t warning, \
                                 navigation_mode_group_t can_arm, navigation_mode_group_t can_run";
                (CHECK_SUMMARY, "arming_check_summary", "Arming checks", arguments)
            }
            Self::CheckFailed(check) => {
                let (_, message) = check.component_and_message();
                let arguments = "navigation_mode_group_t modes, uint8_t health_component_index";
                (CHECK_SUMMARY + 1 + check as u32, check.name(), message, arguments)
            }
            Self::HealthSummary => {
                let arguments = "uint8_t chunk_idx, health_component_t is_present, health_component_t error, \
                                 health_component_t warning";
                (HEALTH_SUMMARY, "health_summary", "Health", arguments)
            }
        }
    }

    /// Its number and definition.
    fn definition(self) -> (String, Value) {
        let (number, name, message, arguments) = self.row();
        let mut definition = json!({ "name": name, "message": message });
        if !arguments.is_empty() {
            let arguments = arguments.split(", ").filter_map(|argument| argument.split_once(' '));
            definition["arguments"] = arguments
                .map(|(kind, name)| json!({ "type": kind, "name": name }))
                .collect();
        }
        if matches!(number, CHECK_SUMMARY | HEALTH_SUMMARY) {
            definition["type"] = "summary".into();
        }
        (number.to_string(), definition)
    }

    pub(super) fn arguments(self) -> [u8; 40] {
        let mut bytes = Vec::with_capacity(40);
        let mut number = |value: u32| bytes.extend_from_slice(&value.to_le_bytes());
        match self {
            Self::ModeChanged(mode) => number(mode.custom_mode()),
            Self::FailsafeEntered(failsafe) => bytes.push(failsafe as u8 + 1),
            Self::ArmingCheckSummary(check) => {
                let failing = check.map_or(HEALTH_NONE, |check| 1 << check.component_and_message().0);
                let groups_that_can = if check.is_none() { MODE_GROUP } else { 0 };
                bytes.push(0);
                let words = [failing, 0, groups_that_can, groups_that_can];
                bytes.extend(words.map(u32::to_le_bytes).concat());
            }
            Self::CheckFailed(check) => {
                number(MODE_GROUP);
                bytes.push(check.component_and_message().0);
            }
            Self::HealthSummary => {
                bytes.push(0);
                bytes.extend([PRESENT, 0, 0].map(u32::to_le_bytes).concat());
            }
            _ => {}
        }
        padded(&bytes)
    }
}

fn entries<'a, N: serde::Serialize>(entries: impl IntoIterator<Item = (u32, N, &'a str)>) -> Value {
    let entry = |(value, name, description): (u32, N, _)| {
        let entry = json!({ "name": name, "description": description });
        (value.to_string(), entry)
    };
    Value::Object(entries.into_iter().map(entry).collect())
}

fn group(events: impl IntoIterator<Item = Event>) -> Value {
    let events: Map<String, Value> = events.into_iter().map(Event::definition).collect();
    json!({ "events": events })
}

/// The enumerations that the events' arguments are of.
fn enums() -> Value {
    let modes = FlightMode::ALL.map(|mode| (mode.custom_mode(), mode.name(), mode.name()));
    let failsafes = Failsafe::ALL.map(|of| (of as u32 + 1, of.name().replace(' ', "_"), of.name()));
    json!({
        "flight_mode_t": {
            "type": "uint32_t", "description": "Custom mode", "entries": entries(modes),
        },
        "failsafe_t": {
            "type": "uint8_t", "description": "Failsafe",
            "entries": entries(failsafes),
        },
        "navigation_mode_group_t": {
            "type": "uint32_t", "is_bitfield": true, "description": "Modes of the same checks",
            "entries": entries([(MODE_GROUP, "all", "All modes")]),
        },
        "health_component_t": {
            "type": "uint32_t", "is_bitfield": true, "description": "Parts of the vehicle",
            "entries": entries([
                (1, "none", "None"),
                (1 << 1, "system", "System"),
                (1 << 2, "attitude_estimate", "Attitude estimate"),
                (1 << 3, "geofence", "Geofence"),
                (BATTERY_BIT, "battery", "Battery"),
            ]),
        },
    })
}

/// The definitions as clients fetch them.
pub(crate) fn definitions() -> Value {
    let happened = [
        Event::Armed,
        Event::Disarmed,
        Event::ModeChanged(FlightMode::Hold),
        Event::FailsafeEntered(Failsafe::SetpointLost),
        Event::FailsafeEnded,
        Event::Terminated,
        Event::TookOff,
        Event::Landed,
    ];
    let checks = ArmingCheck::ALL.map(Event::CheckFailed).into_iter();
    json!({
        "version": 1,
        "components": { "1": {
            "namespace": "vigil",
            "enums": enums(),
            "event_groups": {
                "default": group(happened),
                "arming_check": group(checks.chain([Event::ArmingCheckSummary(None)])),
                "health": group([Event::HealthSummary]),
            },
            "supported_protocols": ["health_and_arming_check"],
            "navigation_mode_groups": {
                "groups": { "0": FlightMode::ALL.map(FlightMode::custom_mode) },
            },
        }},
    })
}
