//! What is compared: inputs and results for the other side, and closures to time.

use crate::record::Record;
use crate::states::{State, watch};
use anyhow::{Result, ensure};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::HashMap;
use std::hint::black_box;
use std::path::Path;
use vigil_adversary::{AttackConfig, Method, StateAttack, Towards};
use vigil_detector::{Background, DeepShap, LstmAd, ROW, WINDOW};
use vigil_nnet::{Isa, Purpose};
use vigil_policy::FrozenActor;
use vigil_policy::actor::{ACTOR_HIDDEN, ActorSpec, CONTEXT, LOW_DIM};
use vigil_types::{DEPTH_COLS, DEPTH_PIXELS, DEPTH_ROWS};

/// A program to time.
pub type Case = Box<dyn FnMut() -> Result<()>>;

/// Courses looked at: development seeds.
const FIRST_COURSE: u64 = 5_000;
const COURSES: u64 = 30;
/// States that DeepSHAP compares with, as in flight.
const BACKGROUNDS: usize = 30;
/// States on which results are compared.
const STATES: usize = 16;
/// Windows for LSTM-AD.
const WINDOWS: usize = 16;
/// States attacked at each setting.
const ATTACKED: usize = 4;
/// ε in 1/255 of 100 m, and iterations.
const SETTINGS: [(f32, u32); 8] = [
    (0.5, 5),
    (0.5, 20),
    (1.0, 1),
    (1.0, 5),
    (1.0, 20),
    (2.0, 5),
    (2.0, 20),
    (5.0, 20),
];
/// The output explained and attacked.
const YAW: usize = 1;

/// Writes inputs and results to `to` and returns the programs to time.
pub fn prepare(actor: Option<&Path>, to: &Path) -> Result<HashMap<&'static str, Case>> {
    let isa = Isa::detect();
    let frozen = match actor {
        Some(path) => FrozenActor::load(path)?,
        None => FrozenActor::built_in()?,
    };
    let mut pilot = frozen.actor(isa)?;
    let flights = (FIRST_COURSE..FIRST_COURSE + COURSES)
        .map(|seed| watch(&mut pilot, seed))
        .collect::<Result<Vec<_>>>()?;
    // One state of each flight as background, one for results.
    let nth = |n: usize| flights.iter().filter_map(move |f| f.get(n));
    let backgrounds: Vec<State> = nth(0).take(BACKGROUNDS).cloned().collect();
    let states: Vec<State> = nth(3).take(STATES).cloned().collect();
    ensure!(
        backgrounds.len() == BACKGROUNDS && states.len() == STATES,
        "the actor ends too many flights early: {} backgrounds, {} states",
        backgrounds.len(),
        states.len()
    );
    let mut record = Record::default();
    record.note("actor_sha256", frozen.sha256());
    record.note("isa", isa.name());
    record_states(&mut record, "background", &backgrounds);
    record_states(&mut record, "state", &states);
    let mut comparison = Comparison {
        record,
        cases: HashMap::new(),
        isa,
        frozen: &frozen,
    };
    comparison.actor(&states)?;
    comparison.hidden_shap(&states, &backgrounds)?;
    comparison.pixel_shap(&states[0], &backgrounds)?;
    comparison.attack(&states)?;
    comparison.lstm_ad()?;
    comparison.record.save(to)?;
    Ok(comparison.cases)
}

fn record_states(record: &mut Record, name: &str, states: &[State]) {
    let image = [1, DEPTH_ROWS, DEPTH_COLS];
    record.floats(&format!("{name}_frame"), &image, states.iter().flat_map(|s| &s.frame));
    let contexts = states.iter().flat_map(|s| &s.beside.context);
    record.floats(&format!("{name}_context"), &[CONTEXT], contexts);
    let low_dims = states.iter().flat_map(|s| s.beside.low_dim.iter());
    record.floats(&format!("{name}_low_dim"), &[LOW_DIM], low_dims);
    let hidden = states.iter().flat_map(|s| &s.hidden);
    record.floats(&format!("{name}_hidden"), &[ACTOR_HIDDEN], hidden);
}

/// What is being prepared.
struct Comparison<'a> {
    record: Record,
    cases: HashMap<&'static str, Case>,
    isa: Isa,
    frozen: &'a FrozenActor,
}

impl Comparison<'_> {
    fn case(&mut self, name: &'static str, run: impl FnMut() -> Result<()> + 'static) {
        self.cases.insert(name, Box::new(run));
    }

    /// The network on a new frame, without the memory's own work: what the other side computes.
    fn actor(&mut self, states: &[State]) -> Result<()> {
        self.record
            .floats("state_action", &[2], states.iter().flat_map(|s| &s.action));
        let graph = ActorSpec::FULL.graph(Purpose::Gradients)?;
        let (isa, params, mut tape) = (self.isa, self.frozen.params.clone(), vec![0.0; graph.tape_len()]);
        let state = states[0].clone();
        self.case("actor", move || {
            graph.forward(isa, &params, black_box(&state.inputs()), &mut tape)?;
            black_box(graph.output(&tape)?);
            Ok(())
        });
        Ok(())
    }

    /// DeepSHAP of the yaw output at the split point.
    fn hidden_shap(&mut self, states: &[State], backgrounds: &[State]) -> Result<()> {
        let split = |states: &[State]| -> Vec<Background> {
            states.iter().map(|s| (s.hidden.to_vec(), s.beside.low_dim)).collect()
        };
        let (points, inputs) = (split(backgrounds), split(states));
        let head = self.frozen.head(Purpose::Multipliers)?;
        let mut shap = vigil_detector::split_point_shap(self.isa, head, &points)?;
        let mut phi = vec![0.0; shap.phi_len()];
        let mut all = Vec::new();
        for (hidden, low_dim) in &inputs {
            shap.evaluate(&[hidden, low_dim])?;
            shap.attribute(YAW, &mut phi)?;
            all.extend_from_slice(&phi);
        }
        self.record.floats("shap_hidden", &[phi.len()], &all);
        let (hidden, low_dim) = inputs[0].clone();
        self.case("shap-hidden", move || {
            shap.evaluate(black_box(&[&hidden, &low_dim]))?;
            Ok(shap.attribute(YAW, &mut phi)?)
        });
        Ok(())
    }

    /// DeepSHAP of the yaw output at the newest frame's pixels and at what the actor holds beside them.
    fn pixel_shap(&mut self, state: &State, backgrounds: &[State]) -> Result<()> {
        let graph = ActorSpec::FULL.graph(Purpose::Multipliers)?;
        let views: Vec<[&[f32]; 3]> = backgrounds.iter().map(State::inputs).collect();
        let mut shap = DeepShap::new(self.isa, graph, &self.frozen.params, &views)?;
        let mut phi = vec![0.0; shap.phi_len()];
        let state = state.clone();
        shap.evaluate(&state.inputs())?;
        shap.attribute(YAW, &mut phi)?;
        let (image, beside) = phi.split_at(DEPTH_PIXELS);
        self.record.floats("shap_pixels", &[1, DEPTH_ROWS, DEPTH_COLS], image);
        self.record.floats("shap_pixels_beside", &[beside.len()], beside);
        self.case("shap-pixels", move || {
            shap.evaluate(black_box(&state.inputs()))?;
            Ok(shap.attribute(YAW, &mut phi)?)
        });
        Ok(())
    }

    /// BIM on the newest frame, clipped and accumulating.
    fn attack(&mut self, states: &[State]) -> Result<()> {
        let settings: Vec<AttackConfig> = [Method::BimClipped, Method::BimAccumulating]
            .into_iter()
            .flat_map(|method| {
                SETTINGS.map(|(epsilon_255, iterations)| AttackConfig {
                    method,
                    epsilon_255,
                    iterations,
                    towards: Towards::Away,
                    ..AttackConfig::PAPER
                })
            })
            .collect();
        self.record.note("attacks", serde_json::to_string(&settings)?);
        let mut yaw_changes = Vec::new();
        for config in &settings {
            let mut attack = StateAttack::new(self.isa, self.frozen, config)?;
            for state in states.iter().take(ATTACKED) {
                let mut frame = state.frame.clone();
                yaw_changes.push(attack.attack(&mut frame, &state.beside)?.yaw_change());
            }
        }
        self.record.floats("attack_yaw_changes", &[ATTACKED], &yaw_changes);
        let mut attack = StateAttack::new(self.isa, self.frozen, &AttackConfig::PAPER)?;
        let (state, mut frame) = (states[0].clone(), states[0].frame.clone());
        self.case("bim", move || {
            frame.copy_from_slice(&state.frame);
            black_box(attack.attack(&mut frame, &state.beside)?);
            Ok(())
        });
        Ok(())
    }

    /// One window through LSTM-AD, with weights of the size that training begins with.
    fn lstm_ad(&mut self) -> Result<()> {
        let mut rng = ChaCha8Rng::seed_from_u64(12);
        let mut params = Vec::new();
        for (name, shape) in LstmAd::tensors() {
            let limit = 2.0 / (shape[0] as f32).sqrt();
            let len = shape.iter().product::<usize>();
            let values: Vec<f32> = (0..len).map(|_| 0.5 * rng.random_range(-limit..limit)).collect();
            self.record.floats(&format!("lstm_ad_{name}"), &shape[1..], &values);
            params.extend(values);
        }
        let mut windows: Vec<[[f32; ROW]; WINDOW]> = vec![[[0.0; ROW]; WINDOW]; WINDOWS];
        for value in windows.iter_mut().flatten().flatten() {
            *value = rng.random_range(-2.0..2.0);
        }
        let mut detector = LstmAd::new(self.isa, &params)?;
        let scores = windows
            .iter()
            .map(|w| Ok(detector.score(w)?))
            .collect::<Result<Vec<f32>>>()?;
        self.record
            .floats("lstm_ad_windows", &[WINDOW, ROW], windows.iter().flatten().flatten());
        self.record.floats("lstm_ad_scores", &[], &scores);
        self.case("lstm-ad", move || {
            black_box(detector.score(black_box(&windows[0]))?);
            Ok(())
        });
        Ok(())
    }
}
