//! `vigil merge`: the whole of the parts of a campaign, or of `vigil reproduce`.

use crate::attack_campaigns;
use crate::campaign::part;
use crate::cli::{collected_parts, evaluate, output, reproduce};
use anyhow::{Context, Result, bail, ensure};
use std::path::PathBuf;
use std::process::ExitCode;

/// Arguments of `vigil merge`.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "\
Examples:
  vigil evaluate --flights 500 -o runs/a.json --shard 1/2   on one machine
  vigil evaluate --flights 500 -o runs/a.json --shard 2/2   on another
  vigil merge runs/a.*.part.json -o runs/a.json             what one machine would have written, byte for byte
  vigil merge runs/mine -o runs/mine/learn.safetensors      what `vigil detector collect` gathers, choose.safetensors beside it
  vigil merge runs/1 runs/2 runs/3 -o runs/all              the data and the page of the folders of `vigil reproduce --shard`

Parts of `vigil evaluate`, `vigil attack completion`, `search` and `defended`, and `vigil detector collect`, in any order; the same part twice does no
harm; a folder stands for all *.part.json in it. Refused are parts of another campaign, actor or program, parts that
contradict each other, and too few of them: the message says which are missing. The parts are kept. docs/cluster.md has lines for SLURM, GNU parallel and Ray.

Exit code: 0 the whole was written, 1 error; then nothing was.")]
pub struct MergeArgs {
    /// The parts, or folders of them.
    #[arg(required = true, value_name = "PART")]
    parts: Vec<PathBuf>,

    /// Where the whole goes: a file, and a folder for that of `vigil reproduce`; `-` is standard output, the table then goes to standard
    /// error.
    #[arg(short = 'o', long, value_name = "FILE")]
    json: PathBuf,

    /// The committed data that the page of `vigil reproduce` needs besides.
    #[arg(long, value_name = "DIR", default_value = "docs/measured")]
    data: PathBuf,
}

/// Joins the parts, prints the table and writes the whole.
///
/// # Errors
/// Parts that contradict each other or are not all; a file that cannot be written.
pub fn run(args: &MergeArgs) -> Result<ExitCode> {
    if args.parts.iter().any(|path| reproduce::is_folder_of_results(path)) {
        ensure!(
            !output::is_stdout(&args.json),
            "the parts of `vigil reproduce` make a folder: name it with -o"
        );
        for path in &args.parts {
            ensure!(
                reproduce::is_folder_of_results(path),
                "{} is no folder of `vigil reproduce`, as others are that were named with it",
                path.display()
            );
        }
        return reproduce::merge(&args.parts, &args.json, &args.data);
    }
    output::prepare(&args.json)?;
    let parts = all_parts(&args.parts)?;
    let first = parts.first().context("name the parts")?;
    match part::command_of(first)?.as_str() {
        evaluate::COMMAND => evaluate::merge(&parts, &args.json),
        collected_parts::COMMAND => collected_parts::merge(&parts, &args.json),
        other => match attack_campaigns::merge(other, &parts, &args.json) {
            Some(merged) => merged,
            None => bail!(
                "{} is a part of `{other}`, which this program does not know",
                first.display()
            ),
        },
    }
}

/// The parts that files and folders stand for, those of a folder by name.
fn all_parts(given: &[PathBuf]) -> Result<Vec<PathBuf>> {
    let mut parts = Vec::new();
    for path in given {
        if !path.is_dir() {
            parts.push(path.clone());
            continue;
        }
        let entries = std::fs::read_dir(path).and_then(|entries| entries.collect::<std::io::Result<Vec<_>>>());
        let mut found: Vec<PathBuf> = entries
            .with_context(|| format!("cannot read {}", path.display()))?
            .into_iter()
            .map(|entry| entry.path())
            .filter(|file| file.to_string_lossy().ends_with(".part.json"))
            .collect();
        ensure!(!found.is_empty(), "{} holds no file *.part.json", path.display());
        found.sort();
        parts.extend(found);
    }
    Ok(parts)
}
