//! The loop allocates nothing after its start.

mod common;
#[path = "../nnet/tests/counting/mod.rs"]
mod counting;

use common::instance::Instance;
use common::{
    LOITER, MISSION, SYSTEM_ID, TestVehicle, arrived, config, free_port, monitored_config, set_parameter,
    undecided_detector,
};
use counting::allocations;
use vigil_detector::{FrozenDetector, Of};
use vigil_firmware::FirmwareConfig;
use vigil_firmware::live_loop::LiveLoop;
use vigil_firmware::pilots::Pilots;
use vigil_firmware::stack::{FlightStack, StackConfig, TickInput, TickOutput};
use vigil_io::clock::monotonic_ns;
use vigil_io::shared_memory::{DEPTH_TOPIC, FramePublisher};
use vigil_mavlink::common::MavParamType;
use vigil_mavlink::framing::encode;
use vigil_mavlink::message;
use vigil_nnet::Purpose;
use vigil_policy::imported::{Channels, Depth, FrozenPolicy, Network, PolicyInputs};
use vigil_types::files::{Access, replace};
use vigil_types::{Datagrams, DepthFrame, Duty, GuidanceState, PilotKind, Reason, STEP_NS, StepTiming};

fn counted(work: impl FnOnce()) -> u64 {
    let before = allocations();
    work();
    allocations() - before
}

#[test]
fn a_whole_flight_of_ticks_allocates_nothing() {
    assert_eq!(
        counted(|| drop(std::hint::black_box(Box::new(1)))),
        1,
        "the counter counts"
    );
    whole_flight(&config());
}

#[test]
fn an_imported_policy_with_field_and_guard_allocates_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("policy.safetensors");
    let text = "input 12288\nconv2d 0 64 96 2 4 8 8 0 relu\ninput 2\nconcat 1 2\ndense 3 386 2 tanh*1.5\noutput 4\n";
    let network: Network = text.parse().unwrap();
    let len = network.graph(Purpose::Gradients).unwrap().param_len();
    let policy = FrozenPolicy {
        network,
        params: (0..len).map(|i| ((i * 37 % 101) as f32 - 50.0) / 2000.0).collect(),
        inputs: PolicyInputs {
            rows: 64,
            cols: 96,
            channels: 2,
            order: Channels::Stack,
            depth: Depth::Contrast,
            scale: 1.0,
            frame_input: 0,
            has_position: true,
            output_scale: 1.0,
        },
        split: Some(1),
        source: String::new(),
    };
    policy.save(&file).unwrap();
    let mut config = config();
    config.pilot.kind = PilotKind::Actor;
    config.pilot.actor_file = Some(file);
    // It has learned nothing and flies in circles, which the guard would take for going astray.
    let patient = |stack: &mut StackConfig| stack.guidance.alarm.astray_limit_m = 0.0;
    let refused = Pilots::of(&config).err().unwrap().to_string();
    assert!(refused.contains("add --detector off"), "{refused}");
    config.detector.enabled = Some(false);
    whole_flight_of(&config, patient);
    // Explained at its convolution, and scored.
    let detector = folder.path().join("detector.safetensors");
    FrozenDetector {
        of: Of::Imported,
        actor_sha256: policy.sha256(),
        backgrounds: (0..10)
            .map(|i| (vec![0.1 * i as f32; 384], [0.5, 0.1].into()))
            .collect(),
        ..undecided_detector()
    }
    .save(&detector)
    .unwrap();
    config.detector.enabled = Some(true);
    config.detector.file = Some(detector);
    whole_flight_of(&config, patient);
    config.detector.threshold = Some(0.4);
    whole_flight_of(&config, patient);
}

#[test]
fn the_actor_s_ticks_with_explanation_verdict_and_recovery_allocate_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let mut config = monitored_config(folder.path());
    for enabled in [false, true] {
        config.detector.enabled = Some(enabled);
        whole_flight(&config);
    }
    // The same with an alarm as soon as the window is full, and the recovery pilot at the controls.
    config.detector.threshold = Some(0.4);
    whole_flight(&config);
}

/// A tick in which nothing is allocated; the vehicle hears what is sent.
fn tick(
    stack: &mut FlightStack,
    output: &mut TickOutput,
    vehicle: &mut TestVehicle,
    step: u64,
    frame: Option<&DepthFrame>,
    received: &Datagrams,
) {
    let input = TickInput {
        now_ns: (step + 1) * STEP_NS,
        timing: StepTiming::of_step(step),
        frame,
        frame_known_altered: false,
        received,
    };
    assert_eq!(counted(|| stack.tick(&input, output)), 0, "step {step}");
    output.sent.iter().for_each(|(_, datagram)| vehicle.hear(datagram));
}

fn whole_flight(config: &FirmwareConfig) {
    whole_flight_of(config, |_| {});
}

fn whole_flight_of(config: &FirmwareConfig, change: impl FnOnce(&mut StackConfig)) {
    let pilots = Pilots::of(config).unwrap();
    let mut stack_config = config.stack();
    change(&mut stack_config);
    let mut stack = FlightStack::with_pilots(&stack_config, pilots).unwrap();
    let mut output = Box::new(TickOutput::default());
    let mut vehicle = TestVehicle::on_ground();
    let mut states = Vec::new();
    let mut sent_bytes = 0;
    let mut recovered = false;
    for step in 0..1200 {
        let (frame, received) = (vehicle.frame((step + 1) * STEP_NS), vehicle.telemetry());
        // Frames stay out for a while in flight, so that the paths of a hold are walked too.
        let frame = (!(500..520).contains(&step)).then_some(&*frame);
        tick(&mut stack, &mut output, &mut vehicle, step, frame, &received);
        sent_bytes += output.sent.iter().map(|(_, datagram)| datagram.len()).sum::<usize>();
        vehicle.advance();
        recovered |= output.report.reasons.contains(Reason::Recovering);
        if !states.contains(&output.report.state) {
            states.push(output.report.state);
        }
    }
    for state in [GuidanceState::Engaging, GuidanceState::Guided, GuidanceState::Hold] {
        assert!(states.contains(&state), "{states:?}");
    }
    assert!(sent_bytes > 10_000);
    assert_eq!(recovered, config.detector.threshold.is_some());
}

#[test]
fn a_guarded_flight_that_is_stopped_and_flown_around_allocates_nothing() {
    let mut config = config();
    config.duty = Duty::FlyAround;
    config.goal = None;
    let mut stack = FlightStack::new(&config.stack()).unwrap();
    let mut output = Box::new(TickOutput::default());
    let mut vehicle = TestVehicle::hovering(2.5);
    let (mut stopped, mut guided) = (false, false);
    for step in 0..1200 {
        let now_ns = (step + 1) * STEP_NS;
        if step == 100 {
            vehicle.mode = MISSION;
        }
        let (frame, mut received) = (vehicle.frame_with_wall(now_ns, 12.0), vehicle.telemetry());
        for message in places(step) {
            assert!(received.push(0, &message));
        }
        tick(&mut stack, &mut output, &mut vehicle, step, Some(&frame), &received);
        stopped |= vehicle.mode == LOITER && output.report.reasons.contains(Reason::CollisionCourse);
        guided |= output.report.state == GuidanceState::Guided;
        vehicle.advance();
    }
    assert!(stopped && guided, "{stopped} {guided}");
}

/// Where the vehicle's local origin is on the globe, and its mission's place 30 m north of it.
fn places(step: u64) -> [Vec<u8>; 2] {
    let (latitude, longitude) = (473_977_420, 85_455_940);
    let origin = message!(GPS_GLOBAL_ORIGIN, latitude, longitude);
    let (time_boot_ms, lat_int, lon_int) = (step as u32 * 50, latitude + 2_698, longitude);
    let place = message!(POSITION_TARGET_GLOBAL_INT, time_boot_ms, lat_int, lon_int);
    [origin, place].map(|message| encode((SYSTEM_ID, 1), 0, &message))
}

#[test]
fn the_live_loop_with_its_log_allocates_nothing_in_steady_state() {
    let (instance, domain) = Instance::joined(0);
    let mut publisher = FramePublisher::create(&domain, DEPTH_TOPIC).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let key = folder.path().join("vigil.key");
    replace(&key, &[7; 32], Access::Private).unwrap();
    let port = free_port();
    let mut config = config();
    config.instance = instance.0;
    config.link = Some(format!("udpin://127.0.0.1:{port}").parse().unwrap());
    // Signs what it sends and keeps its state; this machine's packets need no signature.
    config.signing.key_file = Some(key);
    config.log.directory = Some(folder.path().to_owned());
    // A ground station's link, and parameters that are kept.
    config.links = vec![format!("udpin://127.0.0.1:{}", free_port()).parse().unwrap()];
    config.state.directory = Some(folder.path().join("state"));
    config.rate.priority = 0;
    let mut flight = LiveLoop::open(&config).unwrap();
    flight.start();
    let socket = common::socket();
    socket.connect(("127.0.0.1", port)).unwrap();
    let mut vehicle = TestVehicle::hovering(2.5);
    let mut engaged = false;
    for step in 0..60 {
        publisher.publish(&vehicle.frame(monotonic_ns())).unwrap();
        for (_, datagram) in vehicle.telemetry().iter() {
            socket.send(datagram).unwrap();
        }
        if step == 30 {
            let radius = set_parameter("GD_GOAL_RAD", 2.5, MavParamType::MAV_PARAM_TYPE_REAL32);
            socket.send(&encode((255, 0), 0, &radius)).unwrap();
        }
        let mut state = GuidanceState::Standby;
        let allocations = counted(|| state = flight.step().state);
        // In its first steps the transport maps the publisher's memory.
        assert!(step < 5 || allocations == 0, "step {step}: {allocations} allocations");
        engaged |= state >= GuidanceState::Engaging;
        arrived(&socket).iter().for_each(|datagram| vehicle.hear(datagram));
        vehicle.advance();
    }
    assert!(engaged, "the loop was at work");
    let summary = flight.finish();
    assert_eq!(summary.log.unwrap().records, summary.steps);
    assert!(summary.frames >= 55, "{}", summary.frames);

    // What was set is kept.
    let kept = std::fs::read_to_string(folder.path().join(format!("state/firmware{}.toml", instance.0)));
    assert_eq!(kept.unwrap(), "[parameters]\nGD_GOAL_RAD = 2.5\n");
}
