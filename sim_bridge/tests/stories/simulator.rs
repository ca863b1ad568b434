//! The simulator in lockstep: the same bits for the same seed.

use vigil_autopilot::FlightMode;
use vigil_mavlink::common::{MavFrame, PositionTargetTypemask};
use vigil_mavlink::framing::{encode, encode_payload};
use vigil_mavlink::message;
use vigil_sim::foreign::{ForeignConfig, ForeignFlight};
use vigil_sim::world::{Column, Family, Outcome, generate};
use vigil_sim::{STEP_MS, SimConfig, Simulator, Start};
use vigil_types::{DEPTH_FULL_SCALE_M, Datagrams, DepthFrame, Nanos};

/// A COMMAND_LONG to the vehicle.
fn command(from: (u8, u8), number: u16, params: [f32; 7]) -> Vec<u8> {
    let mut payload: Vec<u8> = params.iter().flat_map(|p| p.to_le_bytes()).collect();
    payload.extend_from_slice(&number.to_le_bytes());
    payload.extend_from_slice(&[1, 1, 0]);
    encode_payload(from, 0, 76, &payload).expect("fits")
}

/// What the vehicle says within some milliseconds.
fn advance(simulator: &mut Simulator, ms: u32) -> Vec<u8> {
    let mut said = Vec::new();
    for _ in 0..ms {
        simulator.advance_1ms();
        simulator
            .endpoint
            .transmit(|_, _, datagram| said.extend_from_slice(datagram));
    }
    said
}

/// A vehicle in the air on a course.
fn airborne(family: Family, seed: u64) -> SimConfig {
    let mut config = SimConfig::new(generate(family, seed), seed);
    config.start = Start::Airborne;
    config
}

/// The digest of three seconds of hovering at a course's start.
fn hover(config: &SimConfig, epoch_ns: Nanos) -> (u64, Box<DepthFrame>) {
    let mut simulator = Simulator::new(config, epoch_ns).expect("valid");
    let mut frame = Box::new(DepthFrame::EMPTY);
    let (from_firmware, mut to_firmware) = (Box::<Datagrams>::default(), Box::<Datagrams>::default());
    for _ in 0..60 {
        simulator.lockstep(&from_firmware, &mut frame, &mut to_firmware);
    }
    (simulator.state_hash(), frame)
}

#[test]
fn movers_move_with_simulated_time_whatever_the_clock_says() {
    let mut config = airborne(Family::Hard, 4);
    let (hash, frame) = hover(&config, 0);
    assert_eq!(hover(&config, 0).0, hash);
    let moved = |other: &DepthFrame| {
        let apart_m = |(a, b): (&f32, &f32)| (a - b).abs() * DEPTH_FULL_SCALE_M;
        let pixels = frame.depth.iter().zip(&other.depth);
        pixels.filter(|p| apart_m(*p) > 0.5).count()
    };
    // Another epoch changes the stamps; what is seen differs by what the vehicle's own motion makes of that.
    let by_epoch = moved(&hover(&config, 77_000_000_000).1);
    // Movers that are elsewhere are seen elsewhere.
    for mover in &mut config.course.movers {
        mover.phase = (mover.phase + 0.3) % 1.0;
    }
    let by_phase = moved(&hover(&config, 0).1);
    assert!(by_phase > 200 && by_epoch * 10 < by_phase, "{by_phase} {by_epoch}");
}

/// A machine that was suspended, or a debugger: caught up with in an instant, the pause would be a second without setpoints.
#[test]
#[allow(deprecated, reason = "the frame that PX4 flies and clients send")]
fn a_simulator_that_stood_still_for_a_second_says_so_and_flies_on_as_if_nothing_had_been() {
    let config = airborne(Family::Validation, 1);
    let setpoint = message!(
        SET_POSITION_TARGET_LOCAL_NED,
        type_mask = PositionTargetTypemask::from_bits_retain(0x5C7),
        target_system = 1,
        target_component = 1,
        coordinate_frame = MavFrame::MAV_FRAME_BODY_NED
    );
    let setpoint = encode((1, 191), 0, &setpoint);
    let offboard = command((1, 191), 176, [129.0, 6.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    let mut simulator = Simulator::new(&config, 0).expect("valid");
    let mut said = Vec::new();
    for step in 0..80 {
        simulator.receive(0, &setpoint);
        if step == 1 {
            simulator.receive(0, &offboard);
        }
        if step == 40 {
            let before_ns = simulator.now_ns();
            simulator.stood_still(1_000_000_000);
            let since_ns = simulator.now_ns() - before_ns;
            assert_eq!(since_ns, 1_000_000_000, "frames have today's stamps");
        }
        said.extend(advance(&mut simulator, STEP_MS));
    }
    let status = simulator.status();
    assert_eq!((status.mode, status.failsafe), (FlightMode::Offboard, None));
    let text = b"simulator stood still for 1.0 s";
    assert!(said.windows(text.len()).any(|window| window == text));
}

/// A vehicle that hit something says so, refuses to arm and to take off with the reason, and flies again after a reboot.
#[test]
fn a_vehicle_that_hit_something_says_why_it_does_not_fly_until_a_reboot_mends_it() {
    let mut config = airborne(Family::Validation, 1);
    // Where the vehicle is.
    let (north_m, east_m) = (config.course.start_ned_m().x, config.course.start_ned_m().y);
    config.course.columns.push(Column {
        north_m,
        east_m,
        radius_m: 0.3,
        height_m: 4.0,
    });
    let mut simulator = Simulator::new(&config, 0).unwrap();
    let said = advance(&mut simulator, 5_000);
    assert_eq!(simulator.ending().map(|e| e.outcome), Some(Outcome::Collision));
    let says = |said: &[u8], text: &str| said.windows(text.len()).any(|window| window == text.as_bytes());
    assert!(says(&said, "collision: motors off until a reboot"), "it is silent");
    assert!(simulator.truth().position_ned_m.z > -0.5, "it lies on the ground");
    let ask = |simulator: &mut Simulator, number: u16, first: f32, ms: u32| {
        let params = [first, 0.0, 0.0, 0.0, 0.0, 0.0, f32::NAN];
        simulator.receive(0, &command((245, 190), number, params));
        advance(simulator, ms)
    };
    let (arm, take_off, reboot) = (400, 22, 246);
    for (command, name) in [(arm, "arming"), (take_off, "takeoff")] {
        let said = ask(&mut simulator, command, 1.0, 100);
        let denial = format!("{name} denied: broken by a collision");
        assert!(says(&said, &denial), "{name} is not refused");
    }
    assert!(!simulator.status().armed);
    let said = ask(&mut simulator, reboot, 1.0, 500);
    assert!(says(&said, "rebooted"));
    assert_eq!(simulator.ending(), None, "another flight begins");
    ask(&mut simulator, arm, 1.0, 100);
    assert!(simulator.status().armed, "{:?}", simulator.status());
    // It rises into the column that stands there: this flight has its own referee.
    ask(&mut simulator, take_off, 0.0, 3_000);
    assert_eq!(simulator.ending().map(|e| e.outcome), Some(Outcome::Collision));
}

/// Its feet take a drop of half a metre, as those of PX4's simulated vehicle take any.
#[test]
fn a_vehicle_that_is_killed_low_flies_again_and_one_that_falls_farther_is_broken() {
    for (height_m, breaks, ends_before) in [(0.45, false, false), (1.2, true, false), (1.2, true, true)] {
        let mut config = airborne(Family::Validation, 1);
        // The end of the flight does not make it whole.
        config.course.time_limit_s = if ends_before { 0.1 } else { 90.0 };
        let mut simulator = Simulator::new(&config, 0).unwrap();
        let mut ask = |number: u16, params: [f32; 2], until: &dyn Fn(&Simulator) -> bool| {
            let [first, second] = params;
            let params = [first, second, 0.0, 0.0, 0.0, 0.0, f32::NAN];
            simulator.receive(0, &command((245, 190), number, params));
            let done = (0..10_000).any(|_| {
                simulator.advance_1ms();
                until(&simulator)
            });
            (done, simulator.ending().is_some(), simulator.status().armed)
        };
        let (land, disarm, kill) = (21, 400, 21196.0);
        ask(land, [0.0; 2], &|s| -s.truth().position_ned_m.z < height_m);
        let falls = |s: &Simulator| s.truth().position_ned_m.z > -0.2 && s.truth().velocity_ned_m_s.norm() < 0.05;
        let (_, has_ended, _) = ask(disarm, [0.0, kill], &falls);
        assert_eq!(has_ended, breaks, "from {height_m} m");
        let (armed, ..) = ask(disarm, [1.0, 0.0], &|s| s.status().armed);
        assert_eq!(armed, !breaks, "from {height_m} m");
    }
}

#[test]
fn our_own_vehicle_heard_by_mavlink_alone_sees_what_its_simulator_shows() {
    let config = airborne(Family::Validation, 7);
    let mut simulator = Simulator::new(&config, 0).expect("valid");
    let foreign_config = ForeignConfig {
        lidar: config.lidar,
        seed: 7,
        ..Default::default()
    };
    let mut foreign = ForeignFlight::new(&config.course, &foreign_config, 0).expect("valid");
    let (mut shown, mut rendered) = (Box::new(DepthFrame::EMPTY), Box::new(DepthFrame::EMPTY));
    let (silence, mut telemetry) = (Box::<Datagrams>::default(), Box::<Datagrams>::default());
    let mut frames = 0;
    for _ in 0..60 {
        simulator.lockstep(&silence, &mut shown, &mut telemetry);
        for (_, datagram) in telemetry.iter() {
            foreign.receive(simulator.now_ns(), datagram);
        }
        frames += u32::from(foreign.capture(simulator.now_ns(), &mut rendered));
    }
    assert!(frames > 35, "{frames} of 60");
    let pixels = shown.depth.iter().zip(&rendered.depth);
    let mut apart_m: Vec<f32> = pixels.map(|(a, b)| (a - b).abs() * DEPTH_FULL_SCALE_M).collect();
    apart_m.sort_by(f32::total_cmp);
    let median_m = apart_m[apart_m.len() / 2];
    assert!(median_m < 0.3, "half of the pixels are within {median_m} m");
    assert_eq!(rendered.header.stamp_ns, simulator.now_ns());
}
