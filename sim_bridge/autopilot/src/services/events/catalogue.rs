//! The events there are: their numbers, their arguments, and their definitions for clients.
//! Format: <https://github.com/mavlink/libevents>.

use crate::flight::{Denial, Failsafe, FlightMode};
use serde_json::{Map, Value, json};
use vigil_mavlink::common::MavSeverity::{
    self, MAV_SEVERITY_CRITICAL as CRITICAL, MAV_SEVERITY_EMERGENCY as EMERGENCY, MAV_SEVERITY_ERROR as ERROR,
    MAV_SEVERITY_INFO as INFO,
};

/// Upper byte of an event's number: the autopilot's name space.
const COMPONENT: u32 = 1 << 24;
/// All modes share the same checks.
pub(super) const MODE_GROUP: u32 = 1;
const BATTERY_BIT: u32 = 1 << 4;
/// Bits of the health components that there are.
pub(super) const PRESENT: u32 = 0b1_1110;

/// What can be reported: its number below the component's, name, message, arguments by type and name, and severity.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Event(u32, &'static str, &'static str, &'static str, pub(super) MavSeverity);

pub(super) const ARMED: Event = Event(1, "armed", "Armed", "", INFO);
pub(super) const DISARMED: Event = Event(2, "disarmed", "Disarmed", "", INFO);
pub(super) const MODE_CHANGED: Event = Event(3, "mode_changed", "Mode: {1}", "flight_mode_t mode", INFO);
pub(super) const FAILSAFE_ENTERED: Event =
    Event(4, "failsafe_entered", "Failsafe: {1}", "failsafe_t failsafe", CRITICAL);
pub(super) const FAILSAFE_ENDED: Event = Event(5, "failsafe_ended", "Failsafe ended", "", INFO);
pub(super) const TERMINATED: Event = Event(6, "terminated", "Flight terminated", "", EMERGENCY);
pub(super) const TOOK_OFF: Event = Event(7, "took_off", "Took off", "", INFO);
pub(super) const LANDED: Event = Event(8, "landed", "Landed", "", INFO);

/// They sum others up.
pub(super) const CHECK_SUMMARY: Event = {
    let arguments = "uint8_t chunk_idx, health_component_t error, health_component_t warning, \
                     navigation_mode_group_t can_arm, navigation_mode_group_t can_run";
    Event(100, "arming_check_summary", "Arming checks", arguments, INFO)
};
pub(super) const HEALTH_SUMMARY: Event = {
    let arguments = "uint8_t chunk_idx, health_component_t is_present, health_component_t error, \
                     health_component_t warning";
    Event(200, "health_summary", "Health", arguments, INFO)
};

/// Why the vehicle cannot be armed, with the index of the health component that it concerns.
pub(super) type ArmingCheck = (u8, Event);

const fn check(component: u8, number: u32, name: &'static str, message: &'static str) -> ArmingCheck {
    let arguments = "navigation_mode_group_t modes, uint8_t health_component_index";
    (component, Event(number, name, message, arguments, ERROR))
}

const CHECKS: [ArmingCheck; 5] = [
    check(1, 101, "check_terminated", "Flight was terminated: reboot first"),
    check(2, 102, "check_tilted", "Vehicle is tilted"),
    check(3, 103, "check_outside_fence", "Vehicle is outside its geofence"),
    check(1, 104, "check_other", "Vehicle is not ready"),
    check(1, 105, "check_sensor_lost", "A sensor is lost"),
];

/// The check that fails.
pub(super) fn check_of(denial: &Denial) -> ArmingCheck {
    let [terminated, tilted, outside_fence, other, sensor_lost] = CHECKS;
    match denial {
        Denial::Terminated(_) => terminated,
        Denial::Tilted => tilted,
        Denial::OutsideFence => outside_fence,
        Denial::SensorLost(_) => sensor_lost,
        _ => other,
    }
}

impl Event {
    pub(super) fn id(self) -> u32 {
        COMPONENT | self.0
    }

    /// Its number and definition.
    fn definition(self) -> (String, Value) {
        let Self(number, name, message, arguments, _) = self;
        let mut definition = json!({ "name": name, "message": message });
        if !arguments.is_empty() {
            let arguments = arguments.split(", ").filter_map(|argument| argument.split_once(' '));
            definition["arguments"] = arguments
                .map(|(kind, name)| json!({ "type": kind, "name": name }))
                .collect();
        }
        if matches!(self, CHECK_SUMMARY | HEALTH_SUMMARY) {
            definition["type"] = "summary".into();
        }
        (number.to_string(), definition)
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
        ARMED,
        DISARMED,
        MODE_CHANGED,
        FAILSAFE_ENTERED,
        FAILSAFE_ENDED,
        TERMINATED,
        TOOK_OFF,
        LANDED,
    ];
    let checks = CHECKS.map(|(_, event)| event).into_iter();
    json!({
        "version": 1,
        "components": { "1": {
            "namespace": "vigil",
            "enums": enums(),
            "event_groups": {
                "default": group(happened),
                "arming_check": group(checks.chain([CHECK_SUMMARY])),
                "health": group([HEALTH_SUMMARY]),
            },
            "supported_protocols": ["health_and_arming_check"],
            "navigation_mode_groups": {
                "groups": { "0": FlightMode::ALL.map(FlightMode::custom_mode) },
            },
        }},
    })
}
