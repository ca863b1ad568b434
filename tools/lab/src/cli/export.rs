//! `vigil export`: an actor or an imported policy as a model of ONNX.

use super::import::{check_not_over, computed};
use crate::cli::output::{self, say};
use anyhow::Result;
use std::path::PathBuf;
use std::process::ExitCode;
use vigil_nnet::Purpose;
use vigil_policy::FrozenPilot;
use vigil_policy::actor::ActorSpec;
use vigil_tools::flight_report::quoted;

/// Arguments of `vigil export`.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "\
Examples:
  vigil export -o actor.onnx                             the built-in actor, for ONNX Runtime and the like
  vigil export --actor mine.safetensors -o mine.onnx     an imported policy, back again

Inputs of an actor of ours: `frame` [1, 1, 128, 256], ranges over 100 m; `context` [1, 328], what it remembers of earlier
frames; `low_dim` [1, 8], goal, own motion and last action (docs/architecture.md). An imported policy has its own inputs, as `frame` and `position`. Output: `action` [1, 2]. Beside the
network the model's metadata says what was exported and how its inputs are made. docs/import.md.")]
pub struct ExportArgs {
    /// The actor or imported policy [default: the built-in actor].
    #[arg(long, value_name = "FILE")]
    actor: Option<PathBuf>,

    /// Where it goes.
    #[arg(short, long, value_name = "FILE.onnx")]
    output: PathBuf,

    /// Print as JSON what the network makes here of the inputs in FILE, to compare with another runtime: a list of lists of numbers, one
    /// for each input, as they are in memory.
    #[arg(long, value_name = "FILE")]
    compute: Option<PathBuf>,
}

/// Writes the model.
pub fn run(args: &ExportArgs) -> Result<ExitCode> {
    output::prepare(&args.output)?;
    for read in args.actor.iter().chain(&args.compute) {
        check_not_over(read, &args.output)?;
    }
    let pilot = FrozenPilot::load_or_built_in(args.actor.as_deref())?;
    let (model, split) = vigil_onnx::export(&pilot)?;
    let (graph, params) = match &pilot {
        FrozenPilot::Actor(actor) => (ActorSpec::FULL.graph(Purpose::Gradients)?, &actor.params),
        FrozenPilot::Imported(policy) => (policy.network.graph(Purpose::Gradients)?, &policy.params),
    };
    let compute = |file: &PathBuf| computed(&graph, params, file);
    let computed_here = args.compute.as_ref().map(compute).transpose()?;
    output::write(&args.output, model)?;
    say!("exported         SHA-256 {}", pilot.sha256());
    if let FrozenPilot::Imported(policy) = &pilot {
        let inputs = policy.inputs;
        let proposed = policy.network.proposed_split(&policy.params, inputs.frame_input);
        let other = split.filter(|_| policy.split != proposed);
        say!(
            "to import it     vigil import {} -o FILE --channels {} --depth {} --scale {} --output-scale {}{}",
            quoted(&args.output.to_string_lossy()),
            inputs.order.name(),
            inputs.depth.name(),
            inputs.scale,
            inputs.output_scale,
            other.map_or_else(String::new, |name| format!(" --split {}", quoted(&name)))
        );
    }
    say!("written          {}", args.output.display());
    if let Some(output) = computed_here {
        say!("{}", serde_json::to_string(&output)?);
    }
    Ok(ExitCode::SUCCESS)
}
