//! The built-in actor looks: blind it fails.

use vigil_lab::trainer::evaluation::{EvaluatedActor, EvaluationSpec, FamilyCount, evaluate};
use vigil_lab::trainer::observation::Drift;
use vigil_nnet::Isa;
use vigil_policy::FrozenActor;
use vigil_sim::world::Family;
use vigil_types::Ablation;

#[test]
fn the_actor_completes_courses_that_it_does_not_complete_blind() {
    let actor = FrozenActor::built_in().unwrap();
    let completed = |ablation| {
        let what = EvaluationSpec {
            family: Family::Validation,
            first_seed: 8_100_000_000,
            flights: 12,
            time_limit_s: 90.0,
            field: false,
            ablation,
            drift: Drift::default(),
        };
        let result = evaluate(EvaluatedActor::Actor(&actor), Isa::detect(), &what).unwrap();
        FamilyCount::new(&what, &result).successes
    };
    // Of 95 % in the mean fewer than 9 of 12 are one chance in five thousand; of 15 % more than 5 are one in two hundred.
    let [seeing, blind] = [Ablation::Nothing, Ablation::Frames].map(completed);
    assert!(seeing >= 9, "{seeing} of 12");
    assert!(blind <= 5, "{blind} of 12 blind");
}
