//! The guidance computer's parameters and OBSTACLE_DISTANCE, as a ground station sees them.

mod common;

use common::{Bench, GROUND_STATION, ME, VEHICLE, bytes_of, messages, texts};
use vigil_mavlink::common::{MavFrame, MavParamError, MavParamType, OBSTACLE_DISTANCE_DATA, PARAM_VALUE_DATA};
use vigil_mavlink::{Companion, CompanionConfig, Flavour, MavMessage, Parameter, ParameterValue, Parameters, message};
use vigil_types::{Datagrams, GuidanceState, Reasons, VehicleRequest};

const REAL: MavParamType = MavParamType::MAV_PARAM_TYPE_REAL32;
const INTEGER: MavParamType = MavParamType::MAV_PARAM_TYPE_INT32;

/// A computer with two parameters.
fn computer(flavour: Flavour) -> Bench {
    let mut bench = Bench::new(flavour);
    *bench.companion.parameters() = Parameters::new([
        Parameter {
            name: "PLT_CRUISE",
            value: ParameterValue::Real(1.5),
            least: 0.1,
            greatest: 1.5,
            in_flight: false,
        },
        Parameter {
            // As long as the wire permits.
            name: "GD_SIXTEEN_CHARS",
            value: ParameterValue::Integer(0),
            least: -3.0,
            greatest: 300.0,
            in_flight: true,
        },
    ]);
    bench
}

impl Bench {
    /// The answers to a message, in a step of `state`.
    fn ask_in(&mut self, state: GuidanceState, message: &MavMessage) -> Vec<PARAM_VALUE_DATA> {
        // A refusal is said four times a second at most.
        for _ in 0..5 {
            self.step(state, Reasons::NONE, VehicleRequest::None);
        }
        self.hear(GROUND_STATION, message);
        let sent = self.step(state, Reasons::NONE, VehicleRequest::None);
        assert!(
            sent.iter()
                .all(|(from, _)| (from.system_id, from.component_id) == (1, 191))
        );
        only!(sent, PARAM_VALUE).collect()
    }

    fn ask(&mut self, message: &MavMessage) -> Vec<PARAM_VALUE_DATA> {
        self.ask_in(GuidanceState::Ready, message)
    }

    fn value(&mut self, index: usize) -> ParameterValue {
        self.companion.parameters().all()[index].value
    }
}

fn list((target_system, target_component): (u8, u8)) -> MavMessage {
    message!(PARAM_REQUEST_LIST, target_system, target_component)
}

fn read(name: &str, param_index: i16) -> MavMessage {
    message!(
        PARAM_REQUEST_READ,
        param_index,
        target_system = ME.0,
        target_component = ME.1,
        param_id = name.into()
    )
}

fn set(name: &str, param_value: f32, param_type: MavParamType) -> MavMessage {
    message!(
        PARAM_SET,
        param_value,
        target_system = ME.0,
        target_component = ME.1,
        param_id = name.into(),
        param_type
    )
}

fn name(value: &PARAM_VALUE_DATA) -> &str {
    value.param_id.to_str().unwrap()
}

#[test]
fn a_ground_station_lists_and_reads_by_name_and_by_index() {
    let mut computer = computer(Flavour::Px4);
    // To this component, and to all of the system.
    for target in [ME, (1, 0)] {
        let all = computer.ask(&list(target));
        let listed: Vec<_> = all.iter().map(|v| (name(v), v.param_index, v.param_count)).collect();
        assert_eq!(listed, [("PLT_CRUISE", 0, 2), ("GD_SIXTEEN_CHARS", 1, 2)]);
        assert_eq!((all[0].param_value, all[0].param_type), (1.5, REAL));
        assert_eq!(all[1].param_type, INTEGER);
    }
    for question in [read("GD_SIXTEEN_CHARS", -1), read("", 1)] {
        let answers = computer.ask(&question);
        assert_eq!(answers.iter().map(name).collect::<Vec<_>>(), ["GD_SIXTEEN_CHARS"]);
    }
}

#[test]
fn what_is_for_others_or_not_there_is_not_answered() {
    let mut computer = computer(Flavour::Px4);
    for message in [
        list((1, 1)),
        list((2, 191)),
        list((2, 0)),
        read("NO_SUCH", -1),
        read("PLT_CRUIS", -1),
        read("", 2),
        set("MIS_TAKEOFF_ALT", 5.0, REAL),
    ] {
        assert_eq!(computer.ask(&message), [], "{message:?}");
    }
    assert!(!computer.companion.parameters().take_changed());
}

#[test]
fn who_asks_the_guidance_computer_for_what_it_has_not_reads_it() {
    let mut computer = computer(Flavour::Px4);
    let errors = |computer: &mut Bench, message: &MavMessage| -> Vec<(String, i16)> {
        computer.ask(message);
        let errors = only!(messages(&computer.sent), PARAM_ERROR).map(|e| {
            assert_eq!(e.error, MavParamError::MAV_PARAM_ERROR_DOES_NOT_EXIST);
            assert_eq!((e.target_system, e.target_component), (255, 190));
            (e.param_id.to_str().unwrap().to_owned(), e.param_index)
        });
        errors.collect()
    };
    let error = |name: &str, index| [(name.to_owned(), index)];
    assert_eq!(errors(&mut computer, &read("NO_SUCH", -1)), error("NO_SUCH", -1));
    assert_eq!(errors(&mut computer, &read("", 7)), error("", 7));
    assert_eq!(errors(&mut computer, &set("NO_SUCH", 1.0, REAL)), error("NO_SUCH", -1));
    // Asked of all components, the vehicle may have it.
    let mut to_all = read("NO_SUCH", -1);
    if let MavMessage::PARAM_REQUEST_READ(m) = &mut to_all {
        m.target_component = 0;
    }
    assert!(errors(&mut computer, &to_all).is_empty());
    assert!(errors(&mut computer, &read("PLT_CRUISE", -1)).is_empty());
}

#[test]
fn a_value_within_its_range_is_set_and_reported() {
    let mut computer = computer(Flavour::Px4);
    let answers = computer.ask(&set("PLT_CRUISE", 0.75, REAL));
    assert_eq!(answers.len(), 1);
    assert_eq!(answers[0].param_value, 0.75);
    assert_eq!(computer.value(0), ParameterValue::Real(0.75));
    assert!(computer.companion.parameters().take_changed());
    assert!(!computer.companion.parameters().take_changed(), "said once");
    // The same again is in order and changes nothing.
    assert_eq!(computer.ask(&set("PLT_CRUISE", 0.75, REAL)).len(), 1);
    assert!(!computer.companion.parameters().take_changed());
}

#[test]
fn a_wrong_type_or_a_value_out_of_range_is_answered_with_the_value_in_force_and_a_word() {
    let mut computer = computer(Flavour::Px4);
    let integer = |value: i32| f32::from_bits(value as u32);
    for (message, why, in_force) in [
        (set("PLT_CRUISE", 1.51, REAL), "out of range", 1.5),
        (set("PLT_CRUISE", 0.0, REAL), "out of range", 1.5),
        (set("PLT_CRUISE", f32::NAN, REAL), "out of range", 1.5),
        (set("PLT_CRUISE", f32::INFINITY, REAL), "out of range", 1.5),
        (set("PLT_CRUISE", 1.0, INTEGER), "wrong type", 1.5),
        (set("GD_SIXTEEN_CHARS", integer(301), INTEGER), "out of range", 0.0),
        (set("GD_SIXTEEN_CHARS", integer(-4), INTEGER), "out of range", 0.0),
        (set("GD_SIXTEEN_CHARS", 1.0, REAL), "wrong type", 0.0),
    ] {
        let answers = computer.ask(&message);
        assert_eq!(
            answers.iter().map(|a| a.param_value).collect::<Vec<_>>(),
            [in_force],
            "{message:?}"
        );
        let said = texts(&computer.sent);
        assert!(said.iter().any(|text| text.contains(why)), "{message:?}: {said:?}");
    }
    assert_eq!(computer.companion.counters().parameters_refused, 8);
    let said = (0..20).filter(|_| {
        computer.hear(GROUND_STATION, &set("PLT_CRUISE", 9.0, REAL));
        computer.step(GuidanceState::Ready, Reasons::NONE, VehicleRequest::None);
        texts(&computer.sent).iter().any(|text| text.contains("out of range"))
    });
    assert!((4..=5).contains(&said.count()), "of twenty in a second");
    assert!(!computer.companion.parameters().take_changed());
}

#[test]
fn in_flight_only_what_is_made_for_it_is_set() {
    use GuidanceState::{Engaging, Guided, Hold, Land};
    let mut computer = computer(Flavour::Px4);
    for state in [Engaging, Guided, Hold, Land] {
        let answers = computer.ask_in(state, &set("PLT_CRUISE", 0.5, REAL));
        assert_eq!(answers[0].param_value, 1.5, "{state:?}");
        assert!(texts(&computer.sent).iter().any(|text| text.contains("not in flight")));
    }
    computer.ask_in(Guided, &set("GD_SIXTEEN_CHARS", f32::from_bits(7), INTEGER));
    assert_eq!(computer.value(1), ParameterValue::Integer(7));
    computer.ask_in(GuidanceState::Ready, &set("PLT_CRUISE", 0.5, REAL));
    assert_eq!(computer.value(0), ParameterValue::Real(0.5));
}

#[test]
fn integers_go_bytewise_to_px4s_clients_and_as_numbers_to_ardupilots() {
    for (flavour, wire) in [(Flavour::Px4, f32::from_bits(-2i32 as u32)), (Flavour::ArduPilot, -2.0)] {
        let mut computer = computer(flavour);
        let answers = computer.ask(&set("GD_SIXTEEN_CHARS", wire, INTEGER));
        assert_eq!(answers[0].param_value.to_bits(), wire.to_bits());
        assert_eq!(computer.value(1), ParameterValue::Integer(-2));
    }
    let mut computer = computer(Flavour::ArduPilot);
    computer.ask(&set("GD_SIXTEEN_CHARS", 1.5, INTEGER));
    assert_eq!(computer.value(1), ParameterValue::Integer(0), "no integer");
}

/// A computer whose vehicle is in the air.
fn in_the_air() -> Companion {
    let mut companion = Companion::new(CompanionConfig::default());
    for message in [message!(HEARTBEAT), message!(LOCAL_POSITION_NED, z = -3.0)] {
        companion.receive(0, 0, &bytes_of(VEHICLE, &message));
    }
    companion
}

fn obstacles(sectors: &[(f32, f32)]) -> OBSTACLE_DISTANCE_DATA {
    let mut sent = Datagrams::default();
    in_the_air().emit_obstacles(5_000_000, Some(sectors.iter().copied()), &mut sent);
    only!(messages(&sent), OBSTACLE_DISTANCE).next().unwrap()
}

/// The bin in which a client looks for a bearing.
fn bin(data: &OBSTACLE_DISTANCE_DATA, bearing_deg: f32) -> usize {
    ((bearing_deg - data.angle_offset) / data.increment_f).round() as usize
}

#[test]
fn obstacles_are_reported_where_they_are() {
    let left = (-59.5f32).to_radians();
    let seen = [
        (left, 4.2),
        (0.3f32.to_radians(), 7.0),
        (0.4f32.to_radians(), 6.5),
        (0.5, f32::INFINITY),
        (-0.5, 80.0),
    ];
    let data = obstacles(&seen);
    assert_eq!((data.min_distance, data.max_distance, data.time_usec), (10, 3000, 5000));
    assert_eq!(data.distances[bin(&data, -59.5)], 420);
    assert_eq!(data.distances[bin(&data, 0.3)], 650, "the nearest of a bin");
    assert_eq!(data.distances[bin(&data, 0.5f32.to_degrees())], 3001, "nothing there");
    assert_eq!(
        data.distances[bin(&data, -0.5f32.to_degrees())],
        3001,
        "beyond what is sent"
    );
    assert_eq!(data.distances[bin(&data, 30.0)], u16::MAX, "not looked at");
    assert!((data.angle_offset + 59.1667).abs() < 1e-3 && (data.increment_f - 1.6667).abs() < 1e-3);
}

/// What a companion of a vehicle in the air knows after it heard this from a component of the vehicle's system.
fn heard(component_id: u8, data: OBSTACLE_DISTANCE_DATA) -> Option<Vec<(f32, f32)>> {
    let mut companion = in_the_air();
    let message = MavMessage::OBSTACLE_DISTANCE(data);
    companion.receive(7_000, 0, &bytes_of((1, component_id), &message));
    let ranges = companion.vehicle().sector_ranges.iter().flatten().next()?;
    assert_eq!((ranges.component, ranges.at_ns), (component_id, 7_000));
    Some(ranges.known().collect())
}

#[test]
fn a_second_sensors_ranges_are_heard_and_what_contradicts_itself_is_not() {
    // What is sent of a scan is understood as it was meant.
    let scan = obstacles(&[(0.0, 2.5), (0.5, f32::INFINITY)]);
    for component in [1, 196] {
        let ranges = heard(component, scan.clone()).expect("usable");
        let bin_rad = scan.increment_f.to_radians();
        let [(ahead_rad, ahead_m), (right_rad, right_m)] = ranges[..] else {
            panic!("{ranges:?}");
        };
        assert!(ahead_rad.abs() <= bin_rad && (ahead_m - 2.5).abs() < 1e-6);
        assert!((right_rad - 0.5).abs() <= bin_rad && right_m.is_infinite());
    }
    let contradicts = |change: fn(&mut OBSTACLE_DISTANCE_DATA)| {
        let mut data = scan.clone();
        change(&mut data);
        assert_eq!(heard(1, data), None);
    };
    contradicts(|data| data.distances[3] = data.max_distance + 2);
    contradicts(|data| data.distances[3] = data.min_distance - 1);
    contradicts(|data| data.distances = [u16::MAX; 72]);
    contradicts(|data| data.min_distance = data.max_distance);
    contradicts(|data| (data.increment, data.increment_f) = (0, 0.0));
    contradicts(|data| data.increment_f = f32::NAN);
    contradicts(|data| data.angle_offset = f32::INFINITY);
    contradicts(|data| data.frame = MavFrame::MAV_FRAME_GLOBAL);
}

#[test]
fn what_cannot_be_is_not_reported() {
    let data = obstacles(&[
        (f32::NAN, 1.0),
        (2.0, 1.0),
        (-2.0, 1.0),
        (0.0, f32::NAN),
        (0.1, 0.0),
        (0.2, -3.0),
    ]);
    assert_eq!(data.distances.iter().filter(|d| **d == u16::MAX).count(), 72 - 3);
    assert_eq!(
        data.distances[bin(&data, 0.1f32.to_degrees())],
        10,
        "nearer than the least sent"
    );
    assert_eq!(data.distances[bin(&data, 0.2f32.to_degrees())], 10);
    assert_eq!(data.distances[bin(&data, 0.01)], 3001, "no distance");
}
