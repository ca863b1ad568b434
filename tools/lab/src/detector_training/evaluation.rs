//! Scoring flights on courses that no detector was trained on, and what the verdicts were worth.

use crate::detector_training::features::Feature;
use crate::detector_training::lstm::WindowScorer;
use crate::detector_training::metrics::{Proportion, Separation, corners, roc};
use crate::explained::{Adversary, Ending, Frame, MAX_STEPS, Plan, Record, Scenario, Step};
use anyhow::Result;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use vigil_adversary::{AttackConfig, EFFECTIVE_YAW, Method, Towards};
use vigil_detector::WINDOW;
use vigil_nnet::Isa;
use vigil_policy::FrozenPilot;
use vigil_sim::world::Family;
use vigil_types::STEP_NS;

/// Flights of one kind, scored together: as they are to be flown, or as they were.
pub struct Set<F> {
    pub name: String,
    pub role: Role,
    pub flights: Vec<F>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Role {
    /// No altered frames: unattacked windows, false alarms.
    Unattacked,
    /// The paper's attack, streaming: the headline's attacked windows.
    Paper,
    /// An attack of a kind that is trained on, at another strength.
    Trained,
    /// An attack of a kind that is not trained on.
    Untrained,
    /// No attack: it must not alarm.
    Control,
}

/// How much is flown for an evaluation.
#[derive(Debug, Clone, Copy, Serialize, clap::Args)]
pub struct EvaluationSize {
    /// Unattacked flights.
    #[arg(long, default_value_t = 200, value_parser = clap::value_parser!(u64).range(1..=MOST_FLIGHTS))]
    pub unattacked: u64,
    /// Flights under the paper's attack.
    #[arg(long, default_value_t = 48, value_parser = clap::value_parser!(u64).range(1..=MOST_FLIGHTS))]
    pub attacked: u64,
    /// Flights under each other attack, and of each control.
    #[arg(long, default_value_t = 12, value_parser = clap::value_parser!(u64).range(1..=MOST_FLIGHTS))]
    pub other: u64,
    /// First seed of the flights.
    #[arg(long = "seed", value_name = "SEED", default_value_t = 6000)]
    pub first_seed: u64,
}

/// More flights than anybody flies.
const MOST_FLIGHTS: u64 = 10_000_000;

/// How a recovery flies in the evaluation: it stops at the second altered frame.
const RECOVERING: Plan = Plan::Recovering {
    delay: 2,
    hover: 20,
    trust: 20,
};

/// Every other attacked flight is recovered, since the verdict must hold there as well.
pub(super) fn plan_of(flight: u64) -> Plan {
    match flight % 2 {
        0 => Plan::Actor,
        _ => RECOVERING,
    }
}

/// Attacked frames after which a flight is cut off.
const ALTERED: u64 = 100;

pub fn sets(size: &EvaluationSize) -> Vec<Set<Scenario>> {
    let validation = |i: u64, plan| Scenario::unattacked(Family::Validation, size.first_seed.wrapping_add(i), plan);
    let attacked = |method, epsilon_255, iterations, i: u64| {
        let mut scenario = validation(i, plan_of(i));
        let config = AttackConfig {
            method,
            epsilon_255,
            iterations,
            towards: [Towards::Left, Towards::Right, Towards::Away][i as usize % 3],
            seed: scenario.seed,
            ..AttackConfig::PAPER
        };
        let length = [5, 50, 100, MAX_STEPS][i as usize / 2 % 4];
        let mut rng = ChaCha8Rng::seed_from_u64(scenario.seed);
        scenario.adversary = Some(Adversary::in_bursts(config, length, MAX_STEPS, &mut rng));
        scenario.altered = ALTERED;
        scenario
    };
    let set = |name: &str, role, count, scenario: &dyn Fn(u64) -> Scenario| Set {
        name: name.to_owned(),
        role,
        flights: (0..count).map(scenario).collect(),
    };
    let unattacked = |i| validation(i, Plan::Actor);
    let mut sets = vec![set("unattacked", Role::Unattacked, size.unattacked, &unattacked)];
    for (method, epsilon_255, iterations, role) in [
        (Method::BimAccumulating, 1.0, 20, Role::Paper),
        (Method::BimAccumulating, 0.5, 20, Role::Trained),
        (Method::BimAccumulating, 1.0, 5, Role::Trained),
        (Method::BimClipped, 5.0, 20, Role::Trained),
        (Method::Fgsm, 10.0, 1, Role::Trained),
        (Method::Pgd, 5.0, 20, Role::Untrained),
        (Method::Momentum, 5.0, 20, Role::Untrained),
        (Method::L2, 5.0, 20, Role::Untrained),
        (Method::Patch, 5.0, 20, Role::Trained),
        (Method::Noise, 1.0, 20, Role::Control),
    ] {
        let name = format!("{} {epsilon_255} x {iterations}", method.name());
        let count = match role {
            Role::Paper => size.attacked,
            _ => size.other,
        };
        let attacked = |i| attacked(method, epsilon_255, iterations, i);
        sets.push(set(&name, role, count, &attacked));
    }
    let control = |name: &str, change: &dyn Fn(&mut Scenario)| {
        set(name, Role::Control, size.other, &|i| {
            let mut scenario = unattacked(i);
            change(&mut scenario);
            scenario
        })
    };
    sets.push(control("LiDAR noise x 2", &|s| s.range_noise = 2.0));
    sets.push(control("LiDAR noise x 4", &|s| s.range_noise = 4.0));
    sets.push(control("wind 3 m/s", &|s| s.wind_m_s = [2.1, -2.1, 0.6]));
    sets.push(control("hard courses", &|s| s.family = Family::Hard));
    sets.push(control("geometric pilot flies", &|s| s.plan = Plan::Geometric));
    sets.push(control("pilots change", &|s| s.plan = Plan::Switching));
    sets
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SetReport {
    pub name: String,
    pub role: Role,
    pub flights: usize,
    /// Flights that reached the goal; those cut off count for neither.
    pub at_goal: Proportion,
    /// Attacked windows scored so.
    pub detected: Proportion,
    /// Of those whose attack moved the yaw by 1 or more.
    pub detected_effective: Proportion,
    /// Of the others.
    pub detected_ineffective: Proportion,
    /// Windows without any altered frame in the actor's state scored attacked.
    pub false_alarms: Proportion,
    /// Windows altered by noise scored attacked.
    pub alarms_on_noise: Proportion,
    /// Altered frames until the first alarm, in bursts that were noticed: median and 90th percentile. 1 is at once.
    pub delay_steps: Option<(f64, f64)>,
    /// Bursts in which an alarm was raised before they ended.
    pub bursts_noticed: Proportion,
    /// Rough pictures by the guard's measure among its altered frames, or among all where none is altered.
    pub rough: Proportion,
    /// Receiver operating characteristic of its attacked windows against those of the unattacked flights: its corners.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub roc: Vec<(f64, f64)>,
}

/// Detection over the number of altered rows in the window.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct RowsReport {
    /// Altered rows among the ten; the newest is one.
    pub attacked_rows: usize,
    pub detected: Proportion,
    /// Accuracy beside as many unattacked windows.
    pub accuracy: f64,
}

#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct AfterReport {
    /// Steps since the last altered frame.
    pub steps_after: usize,
    pub alarmed: Proportion,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Report {
    pub feature: Feature,
    /// A score above it is an attack.
    pub threshold: f32,
    /// The paper's attack against unattacked flights.
    pub separation: Separation,
    /// The same, with only those attacked windows whose yaw moved by 1 or more.
    pub separation_effective: Separation,
    /// Times at which the verdict turned to attack in unattacked flights, at least a second apart.
    pub false_stops: usize,
    pub unattacked_hours: f64,
    /// Detection over the number of attacked rows.
    pub rows: Vec<RowsReport>,
    /// Alarms in the steps after an attack.
    pub after: Vec<AfterReport>,
    pub sets: Vec<SetReport>,
    /// Receiver operating characteristic of the paper's attack: its corners.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub roc: Vec<(f64, f64)>,
}

/// Steps within which alarms count as one.
const ONE_ALARM: usize = 20;

type Scores = Vec<Vec<Option<f32>>>;

/// The scores of the windows to keep.
fn scores_of<'a>(
    flights: impl Iterator<Item = (&'a Record, &'a Vec<Option<f32>>)>,
    keep: &dyn Fn(&Record, usize) -> bool,
) -> Vec<f32> {
    let kept = flights.flat_map(|(r, s)| s.iter().enumerate().filter(move |(step, _)| keep(r, *step)));
    kept.filter_map(|(_, score)| *score).collect()
}

fn attacked(record: &Record, step: usize) -> bool {
    record.steps.get(step).is_some_and(|s| s.frame == Frame::Attacked)
}

fn effective(record: &Record, step: usize) -> bool {
    let step = record.steps.get(step);
    step.is_some_and(|s| s.yaw_change.abs() >= EFFECTIVE_YAW)
}

/// No altered frame, attacked or noisy, is in the actor's state.
fn untouched(record: &Record, step: usize) -> bool {
    record.altered_of_last(step, 1 + record.frame_ages.first().copied().unwrap_or(0)) == 0
}

/// Altered frames from each burst's beginning to its first alarm; `None` if it ended unnoticed. Bursts that begin before the
/// window is full are left out.
fn delays(record: &Record, scores: &[Option<f32>], threshold: f32) -> Vec<Option<usize>> {
    let (mut delays, mut begin) = (Vec::new(), 0);
    let is_attacked = |step: &Step| step.frame == Frame::Attacked;
    for steps in record.steps.chunk_by(|a, b| is_attacked(a) == is_attacked(b)) {
        let end = begin + steps.len();
        if begin >= WINDOW && is_attacked(&steps[0]) {
            let alarm = (begin..end).find(|i| scores[*i].is_some_and(|s| s > threshold));
            delays.push(alarm.map(|i| i - begin + 1));
        }
        begin = end;
    }
    delays
}

/// Times at which the verdict turns to attack in a flight, those within a second counting once.
fn alarms(scores: &[Option<f32>], threshold: f32) -> usize {
    let all = scores.iter().enumerate();
    let raised: Vec<usize> = all
        .filter_map(|(step, score)| (*score)?.gt(&threshold).then_some(step))
        .collect();
    raised.len() - raised.windows(2).filter(|w| w[1] - w[0] <= ONE_ALARM).count()
}

fn report_set(set: &Set<Record>, scores: &Scores, threshold: f32, unattacked: &[f32]) -> SetReport {
    let records = &set.flights;
    let flights = || records.iter().zip(scores);
    let above = |keep: &dyn Fn(&Record, usize) -> bool| Proportion::above(threshold, scores_of(flights(), keep));
    let attacks = scores_of(flights(), &attacked);
    let delays: Vec<Option<usize>> = flights().flat_map(|(r, s)| delays(r, s, threshold)).collect();
    let noticed: Vec<f64> = delays.iter().flatten().map(|d| *d as f64).collect();
    let quantile = |q| crate::statistics::quantile(&noticed, q);
    let ended = records.iter().filter_map(|r| r.outcome);
    let steps = || records.iter().flat_map(|r| &r.steps);
    let is_altered = |s: &&Step| s.frame != Frame::Unaltered;
    let any_altered = steps().any(|s| is_altered(&s));
    let looked_at = || steps().filter(|s| is_altered(s) || !any_altered);
    SetReport {
        name: set.name.clone(),
        role: set.role,
        flights: records.len(),
        at_goal: Proportion::new(ended.clone().filter(|o| *o == Ending::Goal).count(), ended.count()),
        detected: above(&attacked),
        detected_effective: above(&|r, step| attacked(r, step) && effective(r, step)),
        detected_ineffective: above(&|r, step| attacked(r, step) && !effective(r, step)),
        false_alarms: above(&untouched),
        alarms_on_noise: above(&|r, step| r.steps.get(step).is_some_and(|s| s.frame == Frame::Noisy)),
        delay_steps: quantile(0.5).zip(quantile(0.9)),
        bursts_noticed: Proportion::new(noticed.len(), delays.len()),
        rough: Proportion::new(looked_at().filter(|s| s.rough).count(), looked_at().count()),
        roc: match attacks.is_empty() {
            true => Vec::new(),
            false => corners(&roc(&attacks, unattacked)),
        },
    }
}

/// Judges all sets' flights.
///
/// # Errors
/// Parameters of another architecture.
pub fn evaluate(
    isa: Isa,
    pilot: &FrozenPilot,
    scorer: &WindowScorer,
    threshold: f32,
    sets: &[Set<Record>],
) -> Result<Report> {
    let scores = sets.iter().map(|set| scorer.scores(isa, pilot, &set.flights));
    let scores = scores.collect::<Result<Vec<Scores>>>()?;
    Ok(report(scorer.feature, threshold, sets, &scores))
}

fn report(feature: Feature, threshold: f32, sets: &[Set<Record>], scores: &[Scores]) -> Report {
    let all = || sets.iter().zip(scores);
    let flights = |role: Role| {
        let own = all().filter(move |(set, _)| set.role == role);
        own.flat_map(|(set, scores)| set.flights.iter().zip(scores))
    };
    let unattacked = scores_of(flights(Role::Unattacked), &|_, _| true);
    let paper = |keep: &dyn Fn(&Record, usize) -> bool| scores_of(flights(Role::Paper), keep);
    let above = |keep: &dyn Fn(&Record, usize) -> bool| Proportion::above(threshold, paper(keep));
    let (under_attack, moved) = (paper(&attacked), paper(&|r, s| attacked(r, s) && effective(r, s)));
    let separation = Separation::of(threshold, &under_attack, &unattacked);
    let quiet = 1.0 - separation.false_alarms.share.unwrap_or(0.0);
    let rows = (1..=WINDOW)
        .map(|attacked_rows| {
            let detected = above(&|r, step| attacked(r, step) && r.altered_of_last(step, WINDOW) == attacked_rows);
            RowsReport {
                attacked_rows,
                detected,
                accuracy: 0.5 * (detected.share.unwrap_or(f64::NAN) + quiet),
            }
        })
        .collect();
    let after = (1..=2 * WINDOW)
        .map(|steps_after| AfterReport {
            steps_after,
            alarmed: above(&|r, step| {
                r.altered_of_last(step, steps_after) == 0 && r.altered_of_last(step, steps_after + 1) == 1
            }),
        })
        .collect();
    let steps: usize = flights(Role::Unattacked).map(|(r, _)| r.steps.len()).sum();
    Report {
        feature,
        threshold,
        separation,
        separation_effective: Separation::of(threshold, &moved, &unattacked),
        false_stops: flights(Role::Unattacked).map(|(_, s)| alarms(s, threshold)).sum(),
        unattacked_hours: steps as f64 * STEP_NS as f64 * 1e-9 / 3600.0,
        rows,
        after,
        sets: all()
            .map(|(set, scores)| report_set(set, scores, threshold, &unattacked))
            .collect(),
        roc: corners(&roc(&under_attack, &unattacked)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detector_training::flight_files::Class;
    use crate::explained::Step;

    /// A flight in which the marked steps were altered: `a` attacked, `w` attacked to no effect, `n` noisy, `.` not.
    fn record(frames: &str) -> Record {
        let step = |c| Step {
            state: vec![0.0; 48],
            low_dim: [0.0; 8].into(),
            output: [0.0; 2],
            frame: match c {
                'a' | 'w' => Frame::Attacked,
                'n' => Frame::Noisy,
                _ => Frame::Unaltered,
            },
            yaw_change: if c == 'a' { -1.5 } else { 0.0 },
            rough: c == 'a',
        };
        Record {
            frame_ages: vec![4, 3, 2, 1, 0],
            scenario: Scenario::unattacked(Family::Validation, 1, Plan::Actor),
            outcome: Some(Ending::Goal),
            steps: frames.chars().map(step).collect(),
        }
    }

    /// Scores of 1 where marked, else 0; none until the window is full.
    fn scores(marks: &str) -> Vec<Option<f32>> {
        let all = marks.chars().map(|c| f32::from(u8::from(c == '!')));
        all.enumerate().map(|(i, s)| (i + 1 >= WINDOW).then_some(s)).collect()
    }

    #[test]
    fn a_window_belongs_to_the_class_of_what_the_actor_holds() {
        let r = record("..........aw....nn..");
        let class = |step| Class::of(&r, step);
        assert_eq!(class(9), Class::Unattacked);
        assert_eq!((class(10), class(11)), (Class::Attacked, Class::Weak));
        assert!(
            (12..16).all(|s| class(s) == Class::Lingering),
            "four frames later it still holds one"
        );
        assert!((16..20).all(|s| class(s) == Class::Unattacked), "noise is no attack");
        assert_eq!(r.altered_of_last(19, WINDOW), 4);
    }

    #[test]
    fn the_delay_counts_altered_frames_until_the_alarm() {
        let r = record("...aa......aaaaa...aaa..aa");
        let s = scores("!............!!.....!......");
        let want = vec![Some(3), Some(2), None];
        assert_eq!(
            delays(&r, &s, 0.5),
            want,
            "the burst before the window was full does not count"
        );
    }

    #[test]
    fn alarms_within_a_second_are_one() {
        let mut marks = vec!['.'; 80];
        for at in [12, 15, 33, 75] {
            marks[at] = '!';
        }
        assert_eq!(alarms(&scores(&marks.iter().collect::<String>()), 0.5), 2);
        assert_eq!(
            alarms(&scores("!!!!!!!!!........."), 0.5),
            0,
            "before the window is full there is no verdict"
        );
    }

    #[test]
    fn a_report_counts_each_kind_of_window_apart() {
        let sets = [
            (Role::Unattacked, "...................."),
            (Role::Paper, "..........aaww......"),
            (Role::Control, "..........nn........"),
        ];
        let sets = sets.map(|(role, frames)| Set {
            name: format!("{role:?}"),
            role,
            flights: vec![record(frames)],
        });
        let all = [
            vec![scores("...............!....")],
            vec![scores("...........!!.!!....")],
            vec![scores("...........!........")],
        ];
        let r = report(Feature::Shap, 0.5, &sets, &all);
        let counts = |p: &Proportion| (p.count, p.of);
        assert_eq!(counts(&r.separation.detected), (2, 4));
        assert_eq!(counts(&r.separation_effective.detected), (1, 2));
        assert_eq!(counts(&r.separation.false_alarms), (1, 11));
        assert_eq!(r.false_stops, 1);
        assert!((r.unattacked_hours - 1.0 / 3600.0).abs() < 1e-12);
        assert_eq!(counts(&r.sets[1].detected_ineffective), (1, 2));
        assert_eq!(
            counts(&r.sets[1].false_alarms),
            (0, 3),
            "before the burst, and five steps after it"
        );
        assert_eq!(counts(&r.sets[2].alarms_on_noise), (1, 2));
        assert_eq!(r.sets[1].delay_steps, Some((2.0, 2.0)));
        assert_eq!(
            (r.rows[0].detected.of, r.rows[1].detected.count, r.rows[3].detected.of),
            (1, 1, 1)
        );
        assert_eq!(counts(&r.after[0].alarmed), (1, 1));
        assert_eq!(counts(&r.after[2].alarmed), (0, 1));
    }
}
