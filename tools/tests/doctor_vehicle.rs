//! The simulated vehicle as the doctor finds it.

use vigil_sim::world::{Family, generate};
use vigil_sim::{SimConfig, Simulator, Start};
use vigil_tools::doctor::{Examination, ExaminationConfig, Severity};
use vigil_types::{Datagrams, DepthFrame};

#[test]
fn our_own_vehicle_is_fit_to_fly_and_so_is_its_sensor() {
    for start in [Start::Ground, Start::Airborne] {
        let mut config = SimConfig::new(generate(Family::Validation, 7), 7);
        config.start = start;
        let mut simulator = Simulator::new(&config, 0).expect("valid");
        let local = ExaminationConfig {
            is_local: true,
            ..Default::default()
        };
        let mut examination = Examination::new(local, 0);
        let mut frame = Box::new(DepthFrame::EMPTY);
        let (mut questions, mut telemetry) = (Box::<Datagrams>::default(), Box::<Datagrams>::default());
        for _ in 0..160 {
            simulator.lockstep(&questions, &mut frame, &mut telemetry);
            for (_, datagram) in telemetry.iter() {
                examination.receive(simulator.now_ns(), datagram);
            }
            examination.observe_frame(&frame);
            questions.clear();
            examination.ask(simulator.now_ns(), &mut questions);
        }
        let findings = examination.findings(simulator.now_ns());
        let failures: Vec<_> = findings.iter().filter(|f| f.severity == Severity::Failure).collect();
        assert!(failures.is_empty(), "{start:?}: {failures:#?}");
        for name in [
            "LOCAL_POSITION_NED",
            "ATTITUDE",
            "COM_OF_LOSS_T",
            "COM_OBL_RC_ACT",
            "frame pose",
        ] {
            let found = findings.iter().find(|f| f.name == name);
            assert!(
                found.is_some_and(|f| f.severity == Severity::Good),
                "{name}: {findings:#?}"
            );
        }
    }
}
