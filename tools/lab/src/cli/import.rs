//! `vigil import`: a policy of others, in ONNX, becomes one that flies here.

use crate::cli::output::{self, say};
use anyhow::{Context, Result, ensure};
use clap::builder::PossibleValuesParser;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::{Duration, Instant};
use vigil_nnet::{Graph, Isa, Purpose};
use vigil_onnx::{Adapter, Flat};
use vigil_policy::FrozenPolicy;
use vigil_policy::imported::{Channels, Depth};
use vigil_tools::cli::replay;
use vigil_tools::flight_report::quoted;
use vigil_types::STEP_S;

/// What the network files of this project may have as well.
const SIZE_LIMIT: u64 = 256 << 20;
/// A frame of four million pixels as numbers.
const INPUTS_LIMIT: u64 = 64 << 20;
/// Decisions that are timed.
const TIMED: usize = 20;

/// Arguments of `vigil import`.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "\
Examples:
  vigil import policy.onnx -o mine.safetensors                    a policy that takes our pixels, range / 100 m
  vigil import sb3.onnx -o mine.safetensors --scale 255 --output-scale 1.5
                                                                  it learned from bytes, its actions are in ±1
  vigil evaluate --actor mine.safetensors --detector off          fly it
  vigil evaluate --actor mine.safetensors --detector off --guard on
                                                                  the recovery pilot warns and takes over
  vigil detector collect --actor mine.safetensors -o runs/mine    its own detector: also `train`, `evaluate`
  vigil evaluate --actor mine.safetensors --detector-file runs/mine/lstm_ad.safetensors

The policy has one frame as input, of any size, [1, channels, rows, columns]; beside it, if it wants, [1, 2]: distance of the
goal over 20 m (at most 1.05) and bearing in radians. Its output is [1, 2]: forward speed in m/s and yaw in units of
30 °/s, both within ±1.5 after --output-scale. docs/import.md has the operators and what is not supported.")]
pub struct ImportArgs {
    /// The policy.
    #[arg(value_name = "FILE.onnx")]
    model: PathBuf,

    /// Where it goes.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,

    /// What several channels are: the last frames, the newest last, or the newest frame in each.
    #[arg(long, value_parser = PossibleValuesParser::new(Channels::ALL.map(Channels::name)), default_value = Channels::Stack.name())]
    channels: String,

    /// What a pixel is: the range over 100 m, or 1 / (1 + range / 3 m).
    #[arg(long, value_parser = PossibleValuesParser::new(Depth::ALL.map(Depth::name)), default_value = Depth::Range.name())]
    depth: String,

    /// Every pixel is multiplied by it.
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0)]
    scale: f32,

    /// Both outputs are multiplied by it.
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0)]
    output_scale: f32,

    /// The policy takes no picture but one row of values: channels, rows and columns of the frame, the last running fastest (rows,
    /// columns and channels where the last number is the smaller), and where distance and bearing of the goal are in it.
    #[arg(long, value_name = "[goal+]1x24x32[+goal]")]
    flat: Option<Flat>,

    /// The output that is the action, where there are several.
    #[arg(long, value_name = "NAME")]
    action: Option<String>,

    /// The node, or its output, whose values are explained and scored by a detector: 8 to 512, on every way from the frame to the action
    /// [default: the last layer with weights that is so].
    #[arg(long, value_name = "NODE")]
    split: Option<String>,

    /// Print as JSON what the imported network makes of the inputs in FILE, to compare with another runtime: a list of lists of
    /// numbers, one for each input, a frame as [row][column][channel].
    #[arg(long, value_name = "FILE")]
    compute: Option<PathBuf>,
}

/// Imports, says what came of it, and writes the file.
///
/// # Errors
/// A model that is not understood or too large for the step; a file that cannot be written.
pub fn run(args: &ImportArgs) -> Result<ExitCode> {
    for (name, factor) in [("--scale", args.scale), ("--output-scale", args.output_scale)] {
        ensure!(
            factor.is_finite() && factor > 0.0,
            "{name} must be a number above 0, got {factor}"
        );
    }
    output::prepare(&args.output)?;
    for read in [Some(&args.model), args.compute.as_ref()].into_iter().flatten() {
        check_not_over(read, &args.output)?;
    }
    let name = args.model.display().to_string();
    let bytes = vigil_types::files::read(&args.model, SIZE_LIMIT).with_context(|| format!("cannot read {name}"))?;
    let adapter = Adapter {
        order: Channels::from_name(&args.channels).unwrap_or_default(),
        depth: Depth::from_name(&args.depth).unwrap_or_default(),
        scale: args.scale,
        output_scale: args.output_scale,
        flat: args.flat,
        output: args.action.clone(),
        split: args.split.clone(),
    };
    let folder = args.model.parent().unwrap_or(Path::new(""));
    let beside = |name: &str| {
        let file = folder.join(name);
        check_not_over(&file, &args.output).map_err(|e| e.to_string())?;
        vigil_types::files::read(&file, SIZE_LIMIT).map_err(|e| e.to_string())
    };
    let policy = vigil_onnx::import(&name, &bytes, &beside, &adapter)?;
    let graph = policy.network.graph(Purpose::Gradients)?;
    let compute = |file: &PathBuf| computed(&graph, &policy.params, file);
    let output = args.compute.as_ref().map(compute).transpose()?;
    let longest = time(&policy, &graph)?;
    let share = longest.as_secs_f64() / f64::from(STEP_S);
    ensure!(
        share < 0.5,
        "a decision of {name} takes {:.1} ms here, more than half of the step of 50 ms",
        1e3 * longest.as_secs_f64()
    );
    output::write(&args.output, policy.to_bytes()?)?;
    describe(&policy, &graph, longest, &args.output)?;
    if let Some(output) = output {
        say!("{}", serde_json::to_string(&output)?);
    }
    Ok(ExitCode::SUCCESS)
}

/// Whether what is made of a policy goes elsewhere than into the policy itself.
///
/// # Errors
/// `to` is the file that is read, by whatever name.
pub fn check_not_over(policy: &Path, to: &Path) -> Result<()> {
    let itself = || format!("{} is read for it: give another name", to.display());
    replay::check_not_over(policy, to).ok().with_context(itself)
}

/// Says what the policy is, what it costs, and where it was written.
fn describe(policy: &FrozenPolicy, graph: &Graph, longest: Duration, file: &Path) -> Result<()> {
    let memory = 4 * (graph.param_len() + graph.tape_len());
    say!(
        "policy           {} layers, {} parameters, {:.2} million multiply-adds, {:.2} MB",
        policy.network.layers.len(),
        graph.param_len(),
        policy.network.multiply_adds() as f64 / 1e6,
        memory as f64 / 1e6
    );
    let inputs = policy.inputs;
    say!(
        "frame            {} × {} × {} from 128 × 256, {}",
        inputs.rows,
        inputs.cols,
        inputs.channels,
        if inputs.has_position {
            "with the goal's distance and bearing"
        } else {
            "nothing beside it"
        }
    );
    say!(
        "decision         {:.3} ms at most of {TIMED} here, {:.2} % of the step",
        1e3 * longest.as_secs_f64(),
        100.0 * longest.as_secs_f64() / f64::from(STEP_S)
    );
    match policy.split {
        Some(_) => say!(
            "split point      {} values; `vigil detector collect --actor {}` begins to train its detector",
            policy.head()?.width,
            quoted(&file.to_string_lossy())
        ),
        None => say!(
            "split point      none: no layer of 8 to 512 values stands between all of the frame and the action, so no detector can \
             watch it (the guard can)"
        ),
    }
    say!("written          {}", file.display());
    Ok(())
}

/// What a network makes of the inputs in a file: a list of lists of numbers.
///
/// # Errors
/// A file that cannot be read, or that is none; inputs of other lengths.
pub fn computed(graph: &Graph, params: &[f32], file: &Path) -> Result<Vec<f32>> {
    let name = file.display();
    let text = vigil_types::files::read_text(file, INPUTS_LIMIT).with_context(|| format!("cannot read {name}"))?;
    let inputs: Vec<Vec<f32>> =
        serde_json::from_str(&text).with_context(|| format!("{name} is no list of lists of numbers"))?;
    let given: Vec<&[f32]> = inputs.iter().map(Vec::as_slice).collect();
    let mut tape = vec![0.0; graph.tape_len()];
    graph
        .forward(Isa::detect(), params, &given, &mut tape)
        .with_context(|| format!("{name} does not fit the policy"))?;
    Ok(graph.output(&tape)?.to_vec())
}

/// The longest of some decisions after the first, which brings the weights near.
fn time(policy: &FrozenPolicy, graph: &Graph) -> Result<Duration> {
    let inputs: Vec<Vec<f32>> = policy.network.inputs().into_iter().map(|len| vec![0.1; len]).collect();
    let given: Vec<&[f32]> = inputs.iter().map(Vec::as_slice).collect();
    let mut tape = vec![0.0; graph.tape_len()];
    let mut times = Vec::new();
    for _ in 0..=TIMED {
        let begun = Instant::now();
        graph.forward(Isa::detect(), &policy.params, &given, &mut tape)?;
        times.push(begun.elapsed());
    }
    times.remove(0);
    // One of them may have waited for another process.
    times.sort_unstable();
    times.pop();
    Ok(times.last().copied().unwrap_or_default())
}
