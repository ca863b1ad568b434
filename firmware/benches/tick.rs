//! What one step of the flight stack costs, with real frames and telemetry.

#[path = "../tests/common/mod.rs"]
mod common;

use common::{TestVehicle, config, monitored_config};
use divan::Bencher;
use std::cell::RefCell;
use vigil_firmware::FirmwareConfig;
use vigil_firmware::pilots::Pilots;
use vigil_firmware::stack::{FlightStack, TickInput, TickOutput};
use vigil_nnet::Isa;
use vigil_types::{Datagrams, DepthFrame, GuidanceState, PilotKind, STEP_NS, StepTiming};

fn main() {
    divan::main();
}

/// A stack in flight and its vehicle, which stays where it is, so that every step is a guided one.
struct Flight {
    stack: Box<FlightStack>,
    output: Box<TickOutput>,
    vehicle: TestVehicle,
    step: u64,
}

struct Inputs {
    step: u64,
    frame: Option<Box<DepthFrame>>,
    received: Datagrams,
}

impl Flight {
    fn guided(config: &FirmwareConfig, isa: Isa) -> Self {
        let pilots = Pilots::of_with(config, isa).unwrap();
        let mut flight = Self {
            stack: FlightStack::with_pilots(&config.stack(), pilots).unwrap(),
            output: Box::default(),
            vehicle: TestVehicle::hovering(2.5),
            step: 0,
        };
        while flight.output.report.state != GuidanceState::Guided {
            let inputs = flight.inputs(true);
            flight.tick(&inputs);
            assert!(flight.step < 400);
        }
        flight
    }

    fn inputs(&mut self, with_frame: bool) -> Inputs {
        for (_, datagram) in self.output.sent.iter() {
            self.vehicle.hear(datagram);
        }
        self.vehicle.heard.clear();
        self.vehicle.setpoints.truncate(1);
        self.step += 1;
        Inputs {
            step: self.step,
            frame: with_frame.then(|| self.vehicle.frame(self.step * STEP_NS)),
            received: self.vehicle.telemetry(),
        }
    }

    fn tick(&mut self, inputs: &Inputs) {
        let input = TickInput {
            now_ns: inputs.step * STEP_NS,
            timing: StepTiming::of_step(inputs.step),
            frame: inputs.frame.as_deref(),
            frame_known_altered: false,
            received: &inputs.received,
        };
        self.stack.tick(&input, &mut self.output);
    }
}

fn bench(bencher: Bencher, config: &FirmwareConfig, with_frame: bool, isa: Isa) {
    let flight = RefCell::new(Flight::guided(config, isa));
    bencher
        .with_inputs(|| flight.borrow_mut().inputs(with_frame))
        .bench_local_refs(|inputs| flight.borrow_mut().tick(inputs));
}

/// The whole tick in guided flight: frame copied and checked, telemetry parsed, pilot, guidance, packets.
#[divan::bench(sample_size = 1, sample_count = 2000)]
fn guided(bencher: Bencher) {
    bench(bencher, &config(), true, Isa::detect());
}

/// A tick without a new frame: telemetry, guidance, packets, and the pilot while the last frame is fresh.
#[divan::bench(sample_size = 1, sample_count = 2000)]
fn without_a_new_frame(bencher: Bencher) {
    bench(bencher, &config(), false, Isa::detect());
}

/// The same with the actor in the pilot's place.
#[divan::bench(sample_size = 1, sample_count = 2000)]
fn guided_by_the_actor(bencher: Bencher) {
    let mut config = config();
    config.pilot.kind = PilotKind::Actor;
    bench(bencher, &config, true, Isa::detect());
}

/// The same monitored: with explanation against 30 states, LSTM-AD, and the recovery pilot beside the actor. On each instruction set
/// that this processor has.
#[divan::bench(sample_size = 1, sample_count = 2000, args = Isa::available())]
fn guided_by_the_monitored_actor(bencher: Bencher, isa: Isa) {
    let folder = tempfile::tempdir().unwrap();
    bench(bencher, &monitored_config(folder.path()), true, isa);
}
