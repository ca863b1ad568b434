//! LSTM-AD for Python: the frozen one, the monitor of the tick, and training on any rows.

use crate::actor::Learned;
use crate::given::{Floats, array, beside, failed, interruptible, refused, values};
use numpy::{PyReadonlyArray1, PyReadonlyArrayDyn, PyUntypedArrayMethods};
use pyo3::prelude::*;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use vigil_detector::{FrozenDetector, LstmAd, Of, ROW, ROW_LIMIT, WINDOW};
use vigil_lab::detector_training::{Examples, FitConfig, LstmConfig, fit};
use vigil_nnet::{Activation, Graph, Isa, Purpose};
use vigil_policy::actor::LowDim;
use vigil_tools::threads::thread_pool;
use vigil_types::Verdict;

/// A frozen detector.
#[pyclass(module = "vigil._vigil")]
pub struct Detector(FrozenDetector);

#[pymethods]
impl Detector {
    #[new]
    #[pyo3(signature = (path=None))]
    fn new(path: Option<PathBuf>) -> PyResult<Self> {
        let frozen = path.map_or_else(FrozenDetector::built_in, |path| FrozenDetector::load(&path));
        Ok(Self(frozen.map_err(refused)?))
    }

    /// A score above it is an attack.
    #[getter]
    fn threshold(&self) -> f32 {
        self.0.threshold
    }

    /// The digest of the actor that it judges.
    #[getter]
    fn actor_sha256(&self) -> &str {
        &self.0.actor_sha256
    }

    /// Its digest.
    #[getter]
    fn sha256(&self) -> String {
        self.0.sha256()
    }

    /// DeepSHAP's background sample: states, one after the other, and low-dimensional observations.
    fn backgrounds<'py>(&self, py: Python<'py>) -> (usize, Floats<'py>, Floats<'py>) {
        let backgrounds = &self.0.backgrounds;
        let states = backgrounds.iter().flat_map(|(state, _)| state.to_vec());
        let low_dims = backgrounds.iter().flat_map(|(_, inputs)| inputs.to_vec());
        (
            backgrounds.len(),
            array(py, states.collect()),
            array(py, low_dims.collect()),
        )
    }

    /// Parameters, shift and scale of its network.
    fn network<'py>(&self, py: Python<'py>) -> (Floats<'py>, Floats<'py>, Floats<'py>) {
        let d = &self.0;
        [d.params.clone(), d.centre.to_vec(), d.scale.to_vec()]
            .map(|values| array(py, values))
            .into()
    }
}

/// Writes a detector of a policy's explanations at its split point; its digest.
#[pyfunction]
pub fn write_detector(
    path: PathBuf,
    lstm: &Lstm,
    pilot: Learned<'_>,
    states: PyReadonlyArrayDyn<'_, f32>,
    low_dims: PyReadonlyArrayDyn<'_, f32>,
    about: (f32, String, String, u64),
) -> PyResult<String> {
    let (threshold, threshold_choice, training_config, seed) = about;
    let pilot = pilot.frozen();
    let head = pilot.head(Purpose::Multipliers).map_err(refused)?;
    let (state, low_dim) = (head.graph.input_len(0), head.graph.input_len(1));
    let count = states.len() / state;
    let states = values("background states", &states, count * state)?;
    let low_dims = values("background positions", &low_dims, count * low_dim)?;
    let each = states.chunks_exact(state).zip(low_dims.chunks_exact(low_dim));
    let backgrounds = each.map(|(state, low_dim)| {
        let low_dim = LowDim::from_values(low_dim).ok_or_else(|| refused("background positions: of another length"))?;
        Ok((state.to_vec(), low_dim))
    });
    let row = |what: &str, values: &[f32]| {
        <[f32; ROW]>::try_from(values).map_err(|_| {
            let width = values.len();
            refused(format!("{what}: the tick's rows are {ROW} wide, the network's {width}"))
        })
    };
    let frozen = FrozenDetector {
        of: Of::pilot(&pilot),
        actor_sha256: pilot.sha256(),
        backgrounds: backgrounds.collect::<PyResult<_>>()?,
        centre: row("centre", &lstm.centre)?,
        scale: row("scale", &lstm.scale)?,
        threshold,
        threshold_choice,
        params: lstm.params.clone(),
        training_config,
        seed,
        git_commit: None,
    };
    // What it could not score in flight is not written.
    vigil_detector::Monitor::new(Isa::detect(), head, &frozen.actor_sha256, &frozen).map_err(refused)?;
    frozen.save(&path).map_err(refused)?;
    Ok(frozen.sha256())
}

/// A network over ten rows of any width, with the shift and scale of its rows.
#[pyclass(module = "vigil._vigil")]
pub struct Lstm {
    graph: Graph,
    params: Vec<f32>,
    centre: Vec<f32>,
    scale: Vec<f32>,
}

#[pymethods]
impl Lstm {
    #[new]
    fn new(
        params: PyReadonlyArrayDyn<'_, f32>,
        centre: PyReadonlyArrayDyn<'_, f32>,
        scale: PyReadonlyArrayDyn<'_, f32>,
    ) -> PyResult<Self> {
        let width = centre.len();
        let graph = LstmAd::graph(width, LstmAd::CELL, Activation::Sigmoid).map_err(refused)?;
        let scale = values("scale", &scale, width)?.to_vec();
        if scale.iter().any(|scale| *scale <= 0.0) {
            return Err(refused("scale: every value has to be above 0"));
        }
        Ok(Self {
            params: values("parameters", &params, graph.param_len())?.to_vec(),
            centre: values("centre", &centre, width)?.to_vec(),
            scale,
            graph,
        })
    }

    /// Scores of a flight's rows; the first nine have none (not a number).
    fn scores<'py>(&self, py: Python<'py>, rows: PyReadonlyArrayDyn<'py, f32>) -> PyResult<Floats<'py>> {
        let width = self.centre.len();
        let count = rows.len() / width;
        let rows = values("rows", &rows, count * width)?;
        let scores = py.detach(|| {
            let mut rows = rows.to_vec();
            for row in rows.chunks_exact_mut(width) {
                for (x, (centre, scale)) in row.iter_mut().zip(self.centre.iter().zip(&self.scale)) {
                    *x = ((*x - centre) / scale).clamp(-ROW_LIMIT, ROW_LIMIT);
                }
            }
            let rows: Vec<&[f32]> = rows.chunks_exact(width).collect();
            let mut tape = vec![0.0; self.graph.tape_len()];
            let mut scores = vec![f32::NAN; count];
            for (window, score) in rows.windows(WINDOW).zip(scores.iter_mut().skip(WINDOW - 1)) {
                self.graph.forward(Isa::detect(), &self.params, window, &mut tape)?;
                *score = self.graph.output(&tape)?[0];
            }
            Ok(scores)
        });
        Ok(array(py, scores.map_err(|e: vigil_nnet::ShapeError| failed(e))?))
    }
}

/// Verdict, score, contributions of image, bearing, distance and own motion, base, contributions at the split point.
type Scored<'py> = (Option<bool>, Option<f32>, f32, f32, f32, f32, f32, Floats<'py>);

/// Explains and judges a policy's decisions one after the other, as in flight.
#[pyclass(module = "vigil._vigil")]
pub struct Monitor {
    monitor: vigil_detector::Monitor,
    /// Values of the state that it judges.
    #[pyo3(get)]
    width: usize,
}

#[pymethods]
impl Monitor {
    #[new]
    fn new(pilot: Learned<'_>, detector: &Detector) -> PyResult<Self> {
        let pilot = pilot.frozen();
        let head = pilot.head(Purpose::Multipliers).map_err(refused)?;
        let width = head.graph.input_len(0);
        let monitor = vigil_detector::Monitor::new(Isa::detect(), head, &pilot.sha256(), &detector.0);
        Ok(Self {
            monitor: monitor.map_err(refused)?,
            width,
        })
    }

    /// Judges a decision by the policy's state and what it was made from beside it.
    fn judge<'py>(
        &mut self,
        py: Python<'py>,
        state: PyReadonlyArrayDyn<'py, f32>,
        given: Vec<f32>,
    ) -> PyResult<Scored<'py>> {
        let state = values("state", &state, self.width)?;
        let j = self.monitor.score(state, beside(&given)?);
        let verdict = match j.verdict {
            Verdict::Unknown => None,
            Verdict::Clean => Some(false),
            Verdict::Attack => Some(true),
        };
        let phi = array(py, j.phi.to_vec());
        Ok((verdict, j.score, j.image, j.bearing, j.distance, j.told, j.base, phi))
    }

    /// Forgets the explanations: a new flight.
    fn reset(&mut self) {
        self.monitor.reset();
    }
}

/// Windows one after the other, normalised.
struct Windows<'a> {
    rows: &'a [f32],
    width: usize,
    attacked: &'a [bool],
    stopped: &'a AtomicBool,
}

/// Their values, and whether the newest row of each is attacked.
type Labelled<'py> = (PyReadonlyArrayDyn<'py, f32>, PyReadonlyArray1<'py, bool>);

impl<'a> Windows<'a> {
    fn of(what: &str, (rows, attacked): &'a Labelled<'_>, (width, stopped): (usize, &'a AtomicBool)) -> PyResult<Self> {
        let rows = values(what, rows, attacked.len() * WINDOW * width)?;
        let attacked = attacked.as_slice().map_err(refused)?;
        if !(attacked.contains(&true) && attacked.contains(&false)) {
            let text = format!("the {what} have to hold attacked and unattacked ones");
            return Err(refused(text));
        }
        Ok(Self {
            rows,
            width,
            attacked,
            stopped,
        })
    }
}

impl Examples for Windows<'_> {
    fn count(&self) -> usize {
        self.attacked.len()
    }

    fn inputs<'a>(&'a self, i: usize, _: &'a mut Vec<f32>) -> Vec<&'a [f32]> {
        // No inputs fit no network, so that training ends.
        if self.stopped.load(Relaxed) {
            return Vec::new();
        }
        let window = &self.rows[i * WINDOW * self.width..(i + 1) * WINDOW * self.width];
        window.chunks_exact(self.width).collect()
    }

    fn attacked(&self, i: usize) -> bool {
        self.attacked[i]
    }
}

/// Training loss, choosing loss and choosing accuracy of an epoch.
type EpochRow = (f64, f64, f64);

/// Trains on normalised windows, `how`: epochs, batch, rate, seed; returns parameters, the epoch chosen (from 1) and all epochs.
#[pyfunction]
pub fn train<'py>(
    py: Python<'py>,
    learn: Labelled<'py>,
    choose: Labelled<'py>,
    width: usize,
    how: (usize, usize, f32, u64),
    threads: usize,
) -> PyResult<(Floats<'py>, usize, Vec<EpochRow>)> {
    let (epochs, batch, rate, seed) = how;
    let stopped = AtomicBool::new(false);
    let learn = Windows::of("windows to learn from", &learn, (width, &stopped))?;
    let choose = Windows::of("windows that choose", &choose, (width, &stopped))?;
    let fitted = interruptible(py, &stopped, || {
        let graph = LstmAd::graph(width, LstmAd::CELL, Activation::Identity).map_err(refused)?;
        let mut first = vec![0.0; graph.param_len()];
        graph
            .initialize(&mut ChaCha8Rng::seed_from_u64(seed), &mut first)
            .map_err(refused)?;
        let config = FitConfig {
            epochs,
            batch,
            rate,
            seed,
            ..LstmConfig::default().fit
        };
        let pool = thread_pool(threads).map_err(refused)?;
        let fitted = pool.install(|| fit(&graph, Isa::detect(), first, &learn, &choose, &config, &mut |_, _| {}));
        fitted.map_err(refused)
    })?;
    let epochs = fitted.epochs.iter();
    let rows = epochs.map(|e| (e.train_loss, e.choose_loss, e.choose_accuracy));
    Ok((array(py, fitted.params), fitted.chosen, rows.collect()))
}
