//! Sixty short flights that may not change, bit for bit, unless a change is meant to change them: `golden.txt` beside this file.
//! `UPDATE_GOLDEN=1 cargo test --release -p vigil-tests --test golden` writes it anew.
//!
//! A digest covers every byte that the firmware sent, every frame and the vehicle's full state at each step; processors whose
//! kernels fuse multiply and add give the same ones (docs/boards.md).

use std::fmt::Write;
use std::path::Path;
use vigil_adversary::{AttackArgs, Burst, Method};
use vigil_firmware::FirmwareConfig;
use vigil_log::{Reader, Recorder, RecorderConfig};
use vigil_sim::world::{Course, Family, generate, generate_long};
use vigil_sim::{SimConfig, Start};
use vigil_tests::{Pair, airborne, mission, reasons};
use vigil_types::{AlarmResponse, Duty, EngagePolicy, GuidanceState, PilotKind, StepReport};

/// The longest that a flight is followed: 25 s.
const MOST_STEPS: usize = 500;
const SEEDS: [u64; 3] = [4203, 4204, 4205];

/// What is flown, three times.
struct Arm {
    name: String,
    family: Family,
    /// A goal so far away in place of the family's own, metres.
    far_m: Option<f32>,
    attack: AttackArgs,
    /// The first flight is logged, and its log replayed.
    logged: bool,
    prepare: fn(&mut SimConfig, &mut FirmwareConfig),
}

impl Arm {
    fn of(name: &str, prepare: fn(&mut SimConfig, &mut FirmwareConfig)) -> Self {
        Self {
            name: name.to_owned(),
            family: Family::Validation,
            far_m: None,
            attack: AttackArgs::default(),
            logged: false,
            prepare,
        }
    }

    /// The actor without potential field and with its detector, its frames altered from the start.
    fn attacked(name: &str, method: Method) -> Self {
        let mut arm = Self::of(name, |_, firmware| firmware.pilot.apf = false);
        arm.attack.attack = Some(method);
        (arm.attack.iterations, arm.attack.burst) = (5, Burst::Continuous);
        arm
    }

    fn course(&self, seed: u64) -> Course {
        let far = |m| generate_long(self.family, seed, m).expect("a family with far goals");
        self.far_m.map_or_else(|| generate(self.family, seed), far)
    }
}

fn geometric(_: &mut SimConfig, firmware: &mut FirmwareConfig) {
    firmware.pilot.kind = PilotKind::Geometric;
}

/// The vehicle flies its own mission, and the firmware has this duty.
fn guarded(simulation: &mut SimConfig, firmware: &mut FirmwareConfig, duty: Duty) {
    simulation.saved = mission::plan(simulation, 3.0, &[], None);
    (firmware.duty, firmware.engage) = (duty, EngagePolicy::Command);
}

fn arms() -> Vec<Arm> {
    let mut arms = Vec::new();
    for family in [Family::Training, Family::Validation, Family::Hard, Family::Dense] {
        for (pilot, prepare) in [("actor", (|_, _| {}) as fn(&mut _, &mut _)), ("geometric", geometric)] {
            let arm = Arm::of(&format!("{family} {pilot}"), prepare);
            arms.push(Arm {
                family,
                logged: family == Family::Training,
                ..arm
            });
        }
    }
    let far = |name, prepare| Arm {
        far_m: Some(90.0),
        ..Arm::of(name, prepare)
    };
    let guarded_by = |name, prepare| Arm {
        family: Family::Training,
        logged: true,
        ..Arm::of(name, prepare)
    };
    // The guard off: the detector alone raises the alarm.
    let mut burst = Arm::attacked("bim burst", Method::BimAccumulating);
    burst.attack.burst = Burst::Steps(40);
    burst.prepare = |_, firmware| (firmware.pilot.apf, firmware.detector.guard) = (false, Some(false));
    let mut bim = Arm::attacked("bim", Method::BimAccumulating);
    bim.logged = true;
    let mut evading = Arm::attacked("evading", Method::BimClipped);
    let detector = Path::new(env!("CARGO_MANIFEST_DIR")).join("../detector/frozen/lstm_ad.safetensors");
    (evading.attack.evade, evading.attack.evade_guard) = (Some(detector), true);
    evading.prepare = burst.prepare;
    let mut recede = Arm::attacked("recede", Method::Recede);
    recede.attack.epsilon = 4.0;
    arms.extend([
        Arm::of("actor alone", |_, firmware| {
            (firmware.pilot.apf, firmware.detector.enabled) = (false, Some(false));
        }),
        far("far actor", |_, _| {}),
        far("far geometric", geometric),
        Arm::of("ground actor", |simulation, _| simulation.start = Start::Ground),
        burst,
        bim,
        evading,
        recede,
        guarded_by("just stop", |s, f| guarded(s, f, Duty::JustStop)),
        guarded_by("fly around", |s, f| guarded(s, f, Duty::FlyAround)),
        Arm::of("second sensor, wind", |simulation, firmware| {
            (simulation.second_sensor_heads, firmware.second_sensor) = (1, true);
            simulation.wind.mean_ned_m_s = [0.0, 4.0, 0.0];
        }),
        Arm::of("frozen sensor", |simulation, _| {
            simulation.sensor_fault = Some("frozen@4".parse().expect("a fault"));
        }),
    ]);
    arms
}

/// Flies, and says in a line what became of it.
fn fly(arm: &Arm, seed: u64, log: Option<&Path>) -> String {
    let mut simulation = airborne(arm.course(seed), seed);
    let goal_ned_m = simulation.course.goal_ned_m();
    let mut config = FirmwareConfig::to_goal(goal_ned_m);
    (arm.prepare)(&mut simulation, &mut config);
    let mut pair = Pair::of(&simulation, &config);
    if let Some(log) = log {
        let recording = RecorderConfig::lossless(log, config.flight_info());
        let recorder = Recorder::start(recording).expect("a log");
        pair.firmware.record(recorder);
    }
    let attack = arm.attack.attack(None).expect("an attack");
    let mut adversary = attack.map(|a| a.interceptor(seed, goal_ned_m).expect("an adversary"));
    let reports = pair.fly(MOST_STEPS, |pair, step| {
        if step == 39 && config.duty != Duty::Fly {
            pair.simulator.receive(0, &mission::start());
        }
        if let Some(adversary) = &mut adversary {
            adversary
                .pass(step as u64, &mut pair.frame)
                .expect("a frame of its size");
        }
        true
    });
    let count = |is: fn(&&StepReport) -> bool| reports.iter().filter(is).count();
    let guided = count(|r| r.state == GuidanceState::Guided);
    let recovered = count(|r| r.alarm.is_some_and(|a| a.response == AlarmResponse::Recovery));
    let (steps, reasons) = (reports.len(), reasons(&reports));
    let end = pair.outcome().map_or("flying".to_owned(), |end| end.to_string());
    pair.firmware.finish();
    let names: Vec<&str> = reasons.iter().map(|reason| reason.name()).collect();
    let (name, hash, reasons) = (&arm.name, pair.simulator.state_hash(), names.join(", "));
    format!("{name} {seed}: {hash:016x} {end}, {steps} steps, {guided} guided, {recovered} by recovery; {reasons}")
}

#[test]
fn sixty_flights_are_the_ones_of_the_file_and_five_logs_replay_byte_for_byte() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut flown = String::new();
    let mut logs = 0;
    for arm in arms() {
        for seed in SEEDS {
            let log = (arm.logged && seed == SEEDS[0]).then(|| folder.path().join(format!("{logs}.mcap")));
            writeln!(flown, "{}", fly(&arm, seed, log.as_deref())).expect("a text");
            if let Some(log) = log {
                let replayed = vigil_firmware::replay(&mut Reader::open(&log).expect("a log")).expect("a replay");
                assert!(replayed.is_equal(), "{} {seed}: {replayed}", arm.name);
                std::fs::remove_file(log).expect("it is ours");
                logs += 1;
            }
        }
    }
    assert_eq!((flown.lines().count(), logs), (60, 5));
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("rust/golden.txt");
    if std::env::var_os("UPDATE_GOLDEN").is_some() {
        std::fs::write(&file, &flown).expect("written");
    }
    let golden = std::fs::read_to_string(&file).expect("golden.txt");
    let other: Vec<String> = (golden.lines().zip(flown.lines()))
        .filter(|(golden, flown)| golden != flown)
        .map(|(golden, flown)| format!("golden {golden}\nflown  {flown}"))
        .collect();
    assert!(
        other.is_empty() && golden.len() == flown.len(),
        "{} flights differ:\n{}",
        other.len(),
        other.join("\n")
    );
}
