//! `vigil merge`: one report of the flights that several machines flew.

use crate::attack_campaigns;
use crate::campaign::flights;
use crate::cli::{collect, evaluate, output};
use anyhow::{Context, Result, ensure};
use std::path::PathBuf;
use std::process::ExitCode;

/// Arguments of `vigil merge`.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "\
Examples:
  vigil evaluate --seed 1 --flights 500 -o runs/a.json      on one machine
  vigil evaluate --seed 501 --flights 500 -o runs/b.json    on another
  vigil merge runs/a.jsonl runs/b.jsonl -o runs/all.json    what one machine would have written, byte for byte
  vigil merge runs/*/learn.jsonl -o runs/mine/learn.jsonl   flights of `vigil detector collect`, which goes on with them

Flights of `vigil evaluate`, `vigil attack completion`, `search` and `defended`, and `vigil detector collect`, in any order; the
same flight twice does no harm; a folder stands for all *.jsonl in it. Refused are flights of another campaign, actor or program,
flights that contradict each other, and too few of them: the message says which are missing. docs/cluster.md has lines for SLURM,
GNU parallel and Ray.

Exit code: 0 the whole was written, 1 error; then nothing was.")]
pub struct MergeArgs {
    /// Files of flights, or folders of them.
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,

    /// Where the report goes, and the flights beside it; `-` is standard output, the table then goes to standard error.
    #[arg(short = 'o', long, value_name = "FILE")]
    json: PathBuf,
}

/// Puts the flights together, prints the table and writes the report.
///
/// # Errors
/// Flights that contradict each other or are not all; a file that cannot be written.
pub fn run(args: &MergeArgs) -> Result<ExitCode> {
    let files = all_files(&args.files)?;
    output::prepare(&args.json)?;
    let first = files.first().context("name the files")?;
    let command = flights::command_of(first)?;
    ensure!(
        command == collect::COMMAND || args.json.extension().is_none_or(|ending| ending != "jsonl"),
        "-o names the report, and the flights go beside it as .jsonl: give it another ending"
    );
    match command.as_str() {
        evaluate::COMMAND => evaluate::merge(&files, &args.json),
        collect::COMMAND => collect::merge(&files, &args.json),
        other => attack_campaigns::merge(other, &files, &args.json),
    }
}

/// The files that files and folders stand for, those of a folder by name.
fn all_files(given: &[PathBuf]) -> Result<Vec<PathBuf>> {
    let mut files = Vec::new();
    for path in given {
        ensure!(
            !path.join("made-by.toml").exists(),
            "{} is a folder of `vigil reproduce`: `vigil reproduce --from DIR` takes what it measured",
            path.display()
        );
        ensure!(
            !path.to_string_lossy().ends_with(".part.json"),
            "{} is of an earlier version, whose program puts it together",
            path.display()
        );
        if !path.is_dir() {
            files.push(path.clone());
            continue;
        }
        let entries = std::fs::read_dir(path).and_then(|entries| entries.collect::<std::io::Result<Vec<_>>>());
        let entries = entries.with_context(|| format!("cannot read {}", path.display()))?;
        let mut found: Vec<PathBuf> = entries.into_iter().map(|entry| entry.path()).collect();
        found.retain(|file| file.extension().is_some_and(|ending| ending == "jsonl"));
        ensure!(!found.is_empty(), "{} holds no file *.jsonl", path.display());
        found.sort();
        files.extend(found);
    }
    Ok(files)
}
