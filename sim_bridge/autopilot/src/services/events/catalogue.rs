//! The events there are: their numbers, their arguments, and their definitions for clients.
//! Format: <https://github.com/mavlink/libevents>.

use crate::flight::{Denial, Failsafe, FlightMode};
use serde_json::{Map, Value, json};

/// Upper byte of an event's number: the autopilot's name space.
const COMPONENT: u32 = 1 << 24;
/// All modes share the same checks.
pub(super) const MODE_GROUP: u32 = 1;
/// Bit 0 of the health components: none of them.
pub(super) const HEALTH_NONE: u32 = 0;
const BATTERY_BIT: u32 = 1 << 4;
const PRESENT: u32 = 0b1_1110;

/// Why the vehicle cannot be armed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum ArmingCheck {
    Terminated,
    Tilted,
    OutsideFence,
    Other,
    SensorLost,
}

impl From<&Denial> for ArmingCheck {
    fn from(denial: &Denial) -> Self {
        match denial {
            Denial::Terminated => Self::Terminated,
            Denial::Tilted => Self::Tilted,
            Denial::OutsideFence => Self::OutsideFence,
            Denial::SensorLost(_) => Self::SensorLost,
            _ => Self::Other,
        }
    }
}

impl ArmingCheck {
    const ALL: [Self; 5] = [
        Self::Terminated,
        Self::Tilted,
        Self::OutsideFence,
        Self::Other,
        Self::SensorLost,
    ];

    /// Index of the health component it concerns.
    fn component(self) -> u8 {
        match self {
            Self::Terminated | Self::Other | Self::SensorLost => 1,
            Self::Tilted => 2,
            Self::OutsideFence => 3,
        }
    }

    pub(super) fn component_bit(self) -> u32 {
        1 << self.component()
    }

    fn name_and_message(self) -> (&'static str, &'static str) {
        match self {
            Self::Terminated => ("check_terminated", "Flight was terminated: reboot first"),
            Self::Tilted => ("check_tilted", "Vehicle is tilted"),
            Self::OutsideFence => ("check_outside_fence", "Vehicle is outside its geofence"),
            Self::SensorLost => ("check_sensor_lost", "A sensor is lost"),
            Self::Other => ("check_other", "Vehicle is not ready"),
        }
    }
}

/// What can be told.
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
    ArmingCheckSummary { failing: u32, groups_that_can: u32 },
    CheckFailed(ArmingCheck),
    HealthSummary,
}

fn failsafe_number(failsafe: Failsafe) -> u8 {
    match failsafe {
        Failsafe::SetpointLost => 1,
        Failsafe::GeofenceBreached => 2,
        Failsafe::ManualControlLost => 3,
        Failsafe::PositionLost => 4,
    }
}

impl Event {
    pub(super) fn id(self) -> u32 {
        COMPONENT | self.sub_id()
    }

    fn sub_id(self) -> u32 {
        match self {
            Self::Armed => 1,
            Self::Disarmed => 2,
            Self::ModeChanged(_) => 3,
            Self::FailsafeEntered(_) => 4,
            Self::FailsafeEnded => 5,
            Self::Terminated => 6,
            Self::TookOff => 7,
            Self::Landed => 8,
            Self::ArmingCheckSummary { .. } => 100,
            Self::CheckFailed(check) => 101 + check as u32,
            Self::HealthSummary => 200,
        }
    }

    pub(super) fn arguments(self) -> [u8; 40] {
        let mut bytes = Vec::with_capacity(40);
        let mut number = |value: u32| bytes.extend_from_slice(&value.to_le_bytes());
        match self {
            Self::ModeChanged(mode) => number(mode.custom_mode()),
            Self::FailsafeEntered(failsafe) => bytes.push(failsafe_number(failsafe)),
            Self::ArmingCheckSummary {
                failing,
                groups_that_can,
            } => {
                bytes.push(0);
                for value in [failing, 0, groups_that_can, groups_that_can] {
                    bytes.extend_from_slice(&value.to_le_bytes());
                }
            }
            Self::CheckFailed(check) => {
                number(MODE_GROUP);
                bytes.push(check.component());
            }
            Self::HealthSummary => {
                bytes.push(0);
                for value in [PRESENT, 0, 0] {
                    bytes.extend_from_slice(&value.to_le_bytes());
                }
            }
            _ => {}
        }
        let mut arguments = [0; 40];
        for (to, from) in arguments.iter_mut().zip(bytes) {
            *to = from;
        }
        arguments
    }
}

fn entries<'a>(entries: impl IntoIterator<Item = (u32, &'a str, &'a str)>) -> Value {
    let entries = entries.into_iter();
    Value::Object(
        entries
            .map(|(value, name, description)| {
                let entry = json!({ "name": name, "description": description });
                (value.to_string(), entry)
            })
            .collect(),
    )
}

/// An event's definition; arguments by type and name.
fn event(name: &str, message: &str, arguments: &[(&str, &str)]) -> Value {
    let arguments = arguments
        .iter()
        .map(|(kind, name)| json!({ "type": kind, "name": name }));
    json!({ "name": name, "message": message, "arguments": arguments.collect::<Value>() })
}

/// One that sums others up.
fn summary(name: &str, message: &str, arguments: &[(&str, &str)]) -> Value {
    let mut summary = event(name, message, arguments);
    summary["type"] = "summary".into();
    summary
}

fn group<const N: usize>(events: [(Event, Value); N]) -> Value {
    let events: Map<String, Value> = events
        .into_iter()
        .map(|(event, definition)| (event.sub_id().to_string(), definition))
        .collect();
    json!({ "events": events })
}

/// The enumerations that the events' arguments are of.
fn enums() -> Value {
    let modes = FlightMode::ALL.map(|mode| (mode.custom_mode(), mode.name(), mode.name()));
    json!({
        "flight_mode_t": {
            "type": "uint32_t", "description": "Custom mode", "entries": entries(modes),
        },
        "failsafe_t": {
            "type": "uint8_t", "description": "Failsafe",
            "entries": entries([
                (1, "setpoint_lost", "setpoint lost"),
                (2, "geofence_breached", "geofence breached"),
                (3, "manual_control_lost", "manual control lost"),
                (4, "position_lost", "position lost"),
            ]),
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

/// The checks before arming, and their summary.
fn checks() -> Map<String, Value> {
    let check_summary = Event::ArmingCheckSummary {
        failing: 0,
        groups_that_can: 0,
    };
    let mut checks: Map<String, Value> = ArmingCheck::ALL
        .into_iter()
        .map(|check| {
            let (name, message) = check.name_and_message();
            let arguments = [
                ("navigation_mode_group_t", "modes"),
                ("uint8_t", "health_component_index"),
            ];
            (
                Event::CheckFailed(check).sub_id().to_string(),
                event(name, message, &arguments),
            )
        })
        .collect();
    checks.insert(
        check_summary.sub_id().to_string(),
        summary(
            "arming_check_summary",
            "Arming checks",
            &[
                ("uint8_t", "chunk_idx"),
                ("health_component_t", "error"),
                ("health_component_t", "warning"),
                ("navigation_mode_group_t", "can_arm"),
                ("navigation_mode_group_t", "can_run"),
            ],
        ),
    );
    checks
}

/// The definitions as clients fetch them.
pub(crate) fn definitions() -> Value {
    let plain = |name: &str, message: &str| json!({ "name": name, "message": message });
    let happened = group([
        (Event::Armed, plain("armed", "Armed")),
        (Event::Disarmed, plain("disarmed", "Disarmed")),
        (
            Event::ModeChanged(FlightMode::Hold),
            event("mode_changed", "Mode: {1}", &[("flight_mode_t", "mode")]),
        ),
        (
            Event::FailsafeEntered(Failsafe::SetpointLost),
            event("failsafe_entered", "Failsafe: {1}", &[("failsafe_t", "failsafe")]),
        ),
        (Event::FailsafeEnded, plain("failsafe_ended", "Failsafe ended")),
        (Event::Terminated, plain("terminated", "Flight terminated")),
        (Event::TookOff, plain("took_off", "Took off")),
        (Event::Landed, plain("landed", "Landed")),
    ]);
    let health = group([(
        Event::HealthSummary,
        summary(
            "health_summary",
            "Health",
            &[
                ("uint8_t", "chunk_idx"),
                ("health_component_t", "is_present"),
                ("health_component_t", "error"),
                ("health_component_t", "warning"),
            ],
        ),
    )]);
    json!({
        "version": 1,
        "components": { "1": {
            "namespace": "vigil",
            "enums": enums(),
            "event_groups": {
                "default": happened,
                "arming_check": { "events": checks() },
                "health": health,
            },
            "supported_protocols": ["health_and_arming_check"],
            "navigation_mode_groups": {
                "groups": { "0": FlightMode::ALL.map(FlightMode::custom_mode) },
            },
        }},
    })
}
