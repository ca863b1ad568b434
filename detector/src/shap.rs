//! DeepSHAP: what each input contributed to an output, against a background sample.

use alloc::vec::Vec;
use vigil_nnet::{Graph, Isa, Purpose, ShapeError, shape::expect};

/// Why there is no explanation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs, reason = "the texts say what the fields are")]
pub enum ShapError {
    /// No background was given.
    #[error("the background sample is empty; DeepSHAP needs at least one state to compare with")]
    NoBackground,
    /// The graph keeps no values before its curves.
    #[error("the network was built for gradients only; finish its graph for multipliers")]
    Purpose,
    /// None of the graph's inputs is marked to be explained.
    #[error("none of the network's inputs is to be explained")]
    NothingExplained,
    /// There is no output of that number.
    #[error("output {output} was asked for, the network has {outputs}")]
    Output { output: usize, outputs: usize },
    /// [`DeepShap::evaluate`] was not called, or failed.
    #[error("there is no evaluated state to explain")]
    NotEvaluated,
    /// A background's output is NaN or infinite.
    #[error("the network's output for background {background} is not finite")]
    BackgroundNotFinite { background: usize },
    /// The explanation holds NaN or infinity: so did the input, or the network overflowed.
    #[error("the explanation is not finite")]
    NotFinite,
    /// Buffers that do not fit.
    #[error(transparent)]
    Shape(#[from] ShapeError),
}

/// An explainer for one network and one background sample.
///
/// φ = mean over the backgrounds b of m·(x − b), with m the DeepLIFT multipliers (rescale rule; midpoint rule for the
/// products of recurrent layers) between x and b (Lundberg and Lee, "A Unified Approach to Interpreting Model
/// Predictions", 2017). Σφ = f(x) − mean f(b), but for rounding.
///
/// The backgrounds' activations are computed once. An explanation then takes one forward pass and one backward pass for
/// each background and output, and allocates nothing ([`Self::attribute_on_threads`] apart).
#[derive(Debug, Clone)]
pub struct DeepShap {
    isa: Isa,
    graph: Graph,
    params: Vec<f32>,
    packed: Vec<f32>,
    /// One tape for each background, one after the other.
    backgrounds: Vec<f32>,
    /// Mean output of the backgrounds.
    expected: Vec<f32>,
    tape: Vec<f32>,
    evaluated: bool,
    work: Vec<f32>,
    /// One where the explained output is, zero elsewhere.
    seed: Vec<f32>,
    phi_len: usize,
}

impl DeepShap {
    /// Evaluates the backgrounds, `[background][input][values]`: each is the list of the network's inputs. Allocates; nothing after it does.
    ///
    /// # Errors
    /// An empty background sample, inputs that do not fit, outputs that are not finite, a graph that was not made for
    /// [`Purpose::Multipliers`] or explains nothing.
    pub fn new<'a, B: AsRef<[&'a [f32]]>>(
        isa: Isa,
        graph: Graph,
        params: &[f32],
        backgrounds: &[B],
    ) -> Result<Self, ShapError> {
        if graph.purpose() != Purpose::Multipliers {
            return Err(ShapError::Purpose);
        }
        if backgrounds.is_empty() {
            return Err(ShapError::NoBackground);
        }
        let explained = (0..graph.input_count()).filter(|i| graph.is_explained(*i));
        let phi_len = explained.map(|i| graph.input_len(i)).sum();
        if phi_len == 0 {
            return Err(ShapError::NothingExplained);
        }
        let mut packed = vec![0.0; graph.param_len()];
        graph.pack(params, &mut packed)?;
        let mut tapes = vec![0.0; backgrounds.len() * graph.tape_len()];
        let mut expected = vec![0.0f64; graph.output_len()];
        let each = backgrounds.iter().zip(tapes.chunks_exact_mut(graph.tape_len()));
        for (background, (inputs, tape)) in each.enumerate() {
            graph.forward(isa, params, inputs.as_ref(), tape)?;
            let output = graph.output(tape)?;
            if output.iter().any(|y| !y.is_finite()) {
                return Err(ShapError::BackgroundNotFinite { background });
            }
            for (sum, y) in expected.iter_mut().zip(output) {
                *sum += f64::from(*y);
            }
        }
        let count = backgrounds.len() as f64;
        Ok(Self {
            isa,
            params: params.to_vec(),
            packed,
            backgrounds: tapes,
            expected: expected.iter().map(|sum| (sum / count) as f32).collect(),
            tape: vec![0.0; graph.tape_len()],
            evaluated: false,
            work: vec![0.0; graph.work_len()],
            seed: vec![0.0; graph.output_len()],
            phi_len,
            graph,
        })
    }

    /// Length of an explanation: all explained inputs, one after the other.
    pub fn phi_len(&self) -> usize {
        self.phi_len
    }

    /// Number of backgrounds.
    pub fn background_count(&self) -> usize {
        self.backgrounds.len() / self.graph.tape_len()
    }

    /// Mean output of the backgrounds, `[outputs]`: what φ is counted from.
    pub fn expected(&self) -> &[f32] {
        &self.expected
    }

    /// The network.
    pub fn graph(&self) -> &Graph {
        &self.graph
    }

    /// Evaluates the state to be explained, `[input][values]`; returns the network's output, `[outputs]`.
    ///
    /// # Errors
    /// Inputs that do not fit.
    pub fn evaluate(&mut self, inputs: &[&[f32]]) -> Result<&[f32], ShapError> {
        self.evaluated = false;
        self.graph.forward(self.isa, &self.params, inputs, &mut self.tape)?;
        self.evaluated = true;
        Ok(self.graph.output(&self.tape)?)
    }

    /// φ of one output for the evaluated state. `phi` is `[phi_len]` ([`Self::phi_len`]): the explained inputs' values, input after input.
    ///
    /// # Errors
    /// No evaluated state, no such output, a slice of another length, a result that is not finite.
    pub fn attribute(&mut self, output: usize, phi: &mut [f32]) -> Result<(), ShapError> {
        let mut seed = core::mem::take(&mut self.seed);
        let mut work = core::mem::take(&mut self.work);
        let result = self
            .seed(output, phi, &mut seed)
            .and_then(|()| self.sum_over(&self.backgrounds, &seed, &mut work, phi));
        self.seed = seed;
        self.work = work;
        result?;
        self.finish(phi)
    }

    /// The same on several threads, each taking a share of the backgrounds. For large networks: starting threads and
    /// their buffers costs more than a small network's whole explanation. The result differs from
    /// [`Self::attribute`]'s by rounding, and depends on the number of threads.
    ///
    /// # Errors
    /// As [`Self::attribute`].
    #[cfg(feature = "std")]
    pub fn attribute_on_threads(&self, output: usize, threads: usize, phi: &mut [f32]) -> Result<(), ShapError> {
        let mut seed = vec![0.0; self.seed.len()];
        self.seed(output, phi, &mut seed)?;
        let share = self.background_count().div_ceil(threads.max(1)) * self.graph.tape_len();
        let parts: Vec<Result<Vec<f32>, ShapError>> = std::thread::scope(|scope| {
            let seed = &seed;
            let spawn = |tapes| {
                scope.spawn(move || {
                    let mut work = vec![0.0; self.graph.work_len()];
                    let mut part = vec![0.0; self.phi_len];
                    self.sum_over(tapes, seed, &mut work, &mut part).map(|()| part)
                })
            };
            let running: Vec<_> = self.backgrounds.chunks(share).map(spawn).collect();
            running
                .into_iter()
                .map(|thread| thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)))
                .collect()
        });
        phi.fill(0.0);
        for part in parts {
            for (phi, part) in phi.iter_mut().zip(part?) {
                *phi += part;
            }
        }
        self.finish(phi)
    }

    /// Checks the request and marks the output.
    fn seed(&self, output: usize, phi: &[f32], seed: &mut [f32]) -> Result<(), ShapError> {
        if !self.evaluated {
            return Err(ShapError::NotEvaluated);
        }
        expect("explanation", phi, self.phi_len)?;
        let outputs = seed.len();
        seed.fill(0.0);
        let slot = seed.get_mut(output).ok_or(ShapError::Output { output, outputs })?;
        *slot = 1.0;
        Ok(())
    }

    /// `phi = Σ m·(x − b)` over some backgrounds' tapes.
    fn sum_over(&self, tapes: &[f32], seed: &[f32], work: &mut [f32], phi: &mut [f32]) -> Result<(), ShapError> {
        phi.fill(0.0);
        for reference in tapes.chunks_exact(self.graph.tape_len()) {
            self.graph
                .multipliers(self.isa, &self.packed, &self.tape, reference, seed, work)?;
            let mut rest = &mut *phi;
            for i in (0..self.graph.input_count()).filter(|i| self.graph.is_explained(*i)) {
                let m = self.graph.input_gradient(work, i)?;
                let (x, b) = (self.graph.input(&self.tape, i)?, self.graph.input(reference, i)?);
                let (own, others) = rest.split_at_mut_checked(m.len()).unwrap_or_default();
                for ((phi, m), (x, b)) in own.iter_mut().zip(m).zip(x.iter().zip(b)) {
                    *phi += m * (x - b);
                }
                rest = others;
            }
        }
        Ok(())
    }

    /// From the sum over the backgrounds to their mean.
    fn finish(&self, phi: &mut [f32]) -> Result<(), ShapError> {
        let count = self.background_count() as f32;
        let mut sum = 0.0;
        for phi in phi.iter_mut() {
            *phi /= count;
            sum += *phi;
        }
        // One value that is not finite makes the sum so.
        if sum.is_finite() {
            Ok(())
        } else {
            Err(ShapError::NotFinite)
        }
    }
}
