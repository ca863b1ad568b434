//! The laboratory's commands, which `vigil` hands on to the program `vigil-lab` beside it.

use anyhow::{Context, Result, ensure};
use std::ffi::OsString;
use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::{ExitCode, Stdio};

/// The program, and how it is built.
const PROGRAM: &str = "vigil-lab";
const BUILD: &str = "cargo build --release -p vigil-lab";
/// SHA-256 of the sources, which `build.rs` makes: `vigil` and `vigil-lab` of one checkout have the same.
const SOURCES: &str = env!("VIGIL_SOURCES");
/// Where the one that starts the other says its own.
const SOURCES_VARIABLE: &str = "VIGIL_SOURCES_OF_CALLER";

/// The laboratory's commands.
#[derive(clap::Subcommand)]
pub enum Command {
    /// Train an actor by value: critics that see the true state, reward along the shortest free path.
    Learn(Words),
    /// Evaluate an actor alone, the potential field off and on.
    Rollout(Words),
    /// Table I and figures 9 and 10 from the logs of training runs of yours.
    Report(Words),
    /// Attack the actor: on states, on scenes, in campaigns of flights.
    Attack(Words),
    /// Gather data for the detector, train it, measure how well it detects.
    Detector(Words),
    /// Every table and figure of the paper and ours, from data or flown anew, on one page.
    Reproduce(Words),
    /// Make one report of flights over several machines' seeds.
    Merge(Words),
    /// Import a policy of others from ONNX.
    Import(Words),
    /// Export an actor or an imported policy to ONNX.
    Export(Words),
    /// Measure what this machine makes of the loop.
    Bench(Words),
}

/// Whatever `vigil-lab` is to read.
#[derive(Debug, Clone, clap::Args)]
#[command(disable_help_flag = true)]
pub struct Words {
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, hide = true)]
    _words: Vec<OsString>,
}

fn is_own(word: &OsString) -> bool {
    word.to_str().is_some_and(<Command as clap::Subcommand>::has_subcommand)
}

/// Whether these words ask for help with a command of the laboratory, whose arguments only `vigil-lab` knows.
pub fn is_asked_about(words: impl Iterator<Item = OsString>) -> bool {
    let words: Vec<OsString> = words.take(3).collect();
    let is_help = words.first().is_some_and(|word| word == "help");
    words == ["help", "log", "film"] || is_help && words.get(1).is_some_and(is_own)
}

/// Becomes `vigil-lab` with the arguments of this process; `log film` is its `film`.
pub fn hand_on() -> Result<ExitCode> {
    let mut words: Vec<OsString> = std::env::args_os().skip(1).collect();
    let mut before = words.iter().take_while(|word| !is_own(word));
    if let Some(log) = before.position(|word| word == "log") {
        words.remove(log);
    }
    let error = program()?.args(words).exec();
    Err(error).context(PROGRAM)
}

/// Whether a film of this name can be made.
///
/// # Errors
/// An mp4 without the program that makes it; `vigil-lab` is not built.
pub fn check_film(to: &Path) -> Result<()> {
    let checked = program()?.args(["film", "--check", "-o"]).arg(to).status()?;
    ensure!(checked.success(), "no film {}", to.display());
    Ok(())
}

/// Films the flight whose log lies in `folder`; what came of it in words.
///
/// # Errors
/// `vigil-lab` is not built, or says why there is no film.
pub fn film(folder: &Path, to: &Path, title: &str) -> Result<String> {
    let mut film = program()?;
    film.arg("film").arg(folder).arg("-o").arg(to).args(["--title", title]);
    if super::output::is_stdout(to) {
        film.stdout(Stdio::inherit());
    }
    let filmed = film.stderr(Stdio::inherit()).output()?;
    ensure!(filmed.status.success(), "no film of {}", folder.display());
    Ok(String::from_utf8_lossy(&filmed.stdout).into_owned())
}

/// `vigil-lab`, which lies beside this program.
pub fn program() -> Result<std::process::Command> {
    let file: PathBuf = std::env::current_exe()?.with_file_name(PROGRAM);
    ensure!(
        file.is_file(),
        "this is done by the laboratory, {}, which is not built: `{BUILD}`",
        file.display()
    );
    let mut program = std::process::Command::new(file);
    program.env(SOURCES_VARIABLE, SOURCES);
    Ok(program)
}

/// Whether who started this process is of the same sources.
pub fn check_caller() -> Result<()> {
    let short = |digest: &str| digest.chars().take(12).collect::<String>();
    let caller = std::env::var(SOURCES_VARIABLE).unwrap_or_else(|_| SOURCES.to_owned());
    ensure!(
        caller == SOURCES,
        "this {PROGRAM} is of other sources ({}) than the `vigil` that started it ({}): `{BUILD}`, and `cargo build --release`",
        short(SOURCES),
        short(&caller)
    );
    Ok(())
}
