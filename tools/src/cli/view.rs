//! `vigil view`: a flight log in the viewers that people have.

use crate::cli::output::{self, Interrupt, say, tell};
use crate::cli::replay::{check_not_over, find_log};
use anyhow::{Context, Result, bail, ensure};
use std::ffi::OsStr;
use std::fs::File;
use std::io::{self, ErrorKind, Write};
use std::net::TcpListener;
use std::os::fd::AsRawFd;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitCode, Stdio};
use vigil_log::Reader;
use vigil_types::files::{Access, replace_with};

/// The viewer that the script was written for.
const RERUN_VERSION: &str = "0.41.0";
/// Reads a log and hands it to the viewer.
const SCRIPT: &str = include_str!("../../assets/viewers/rerun_view.py");
/// Where Foxglove's panels stand.
const FOXGLOVE_LAYOUT: &str = include_str!("../../assets/viewers/foxglove-layout.json");

/// What the script says while it follows flights, beside their logs.
const LOG: &str = "viewer.log";

/// Arguments of `vigil view`.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "\
Examples:
  vigil view runs/fly-1760000000-7             the flight in Rerun: course, path, depth, score, alarms, in a ready layout
  vigil view runs/fly-1760000000-7 --follow    one that flies at this moment (or `vigil fly --view`)
  vigil view flight-0001.mcap --save 7.rrd     a recording to send to somebody: `rerun 7.rrd` opens it
  vigil view flight-0001.mcap --foxglove       how Foxglove opens it, with our layout

Rerun comes from Python's packages; where it is missing, the command that installs it is shown. docs/view.md shows what is seen where.
Exit code: 0 opened, 1 no viewer, a port that is taken, a log that cannot be read.")]
pub struct ViewArgs {
    /// A flight log (MCAP), or a folder that holds one.
    log: PathBuf,

    /// The log is still being written: show what comes.
    #[arg(long)]
    follow: bool,

    /// Write a recording for the viewer instead of opening it.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["follow", "foxglove"])]
    save: Option<PathBuf>,

    /// Write the layout for Foxglove beside the log and say how to open both.
    #[arg(long, conflicts_with = "follow")]
    foxglove: bool,

    #[command(flatten)]
    viewer: ViewerArgs,
}

/// Which viewer.
#[derive(Debug, Clone, clap::Args)]
pub struct ViewerArgs {
    /// Port on which the viewer listens.
    #[arg(long, value_name = "PORT", default_value_t = 9876, value_parser = clap::value_parser!(u16).range(1..))]
    view_port: u16,

    /// The Python that has the viewer, of a virtual environment for example.
    #[arg(long, value_name = "PROGRAM", default_value = "python3")]
    python: PathBuf,
}

impl ViewerArgs {
    /// Whether the viewer is there.
    ///
    /// # Errors
    /// It is not: the message says how to get it.
    pub fn check(&self) -> Result<()> {
        let python = self.python.display();
        let how = format!(
            "`{python} -m pip install rerun-sdk=={RERUN_VERSION} mcap==1.6.0 mcap-protobuf-support==0.6.0`, in a virtual environment for \
             example, whose Python --python names"
        );
        let asked = Command::new(&self.python)
            .args([
                "-c",
                "import mcap, mcap_protobuf, numpy, rerun; print(rerun.__version__)",
            ])
            .stdin(Stdio::null())
            .output();
        let asked = match asked {
            Err(error) if error.kind() == ErrorKind::NotFound => {
                bail!("no viewer: there is no program {python}; install Python 3.10 or newer, then {how}")
            }
            other => other.with_context(|| format!("cannot start {python}"))?,
        };
        ensure!(asked.status.success(), "no viewer: {python} lacks its packages; {how}");
        let version = String::from_utf8_lossy(&asked.stdout);
        let version = version.trim();
        if version != RERUN_VERSION {
            tell!(
                "vigil: Rerun {version} is installed; the layout was made for {RERUN_VERSION} and may look otherwise"
            );
        }
        Ok(())
    }

    /// Whether the viewer is there and its port is free.
    ///
    /// # Errors
    /// No viewer, or a port that is taken: the message says what to do.
    pub fn check_with_port(&self) -> Result<()> {
        self.check()?;
        match TcpListener::bind(("0.0.0.0", self.view_port)) {
            Ok(_) => Ok(()),
            Err(error) if error.kind() == ErrorKind::AddrInUse => bail!(
                "port {} is taken, by a viewer that is open perhaps: close it, or choose another port with --view-port",
                self.view_port
            ),
            Err(error) => Err(error).with_context(|| format!("cannot listen on port {}", self.view_port)),
        }
    }

    /// Starts the script, which opens the viewer; what it says goes to the file `log`, or to standard error.
    fn start(&self, arguments: &[&OsStr], log: Option<&Path>) -> Result<Child> {
        let mut command = Command::new(&self.python);
        command.arg("-").args(arguments);
        command.args(["--port", &self.view_port.to_string()]);
        command.stdin(Stdio::piped()).stdout(Stdio::null());
        if let Some(path) = log {
            command.stderr(File::create(path).with_context(|| format!("cannot write {}", path.display()))?);
        }
        let mut child = command
            .spawn()
            .with_context(|| format!("cannot start {}", self.python.display()))?;
        let mut script = child.stdin.take().context("no way to hand over the script")?;
        script
            .write_all(SCRIPT.as_bytes())
            .context("the viewer's script was not taken")?;
        Ok(child)
    }

    /// Shows what flies and has its logs in `folder`: `--follow` one flight, `--flights` several by their logs' names (without their
    /// ending, a comma between two), each in a tab of its own and all side by side. The script reads what the recorder has flushed to the
    /// file: the firmware does not know of it. A log that is not there when it is asked to end (SIGTERM) is not waited for any more.
    pub fn follow(&self, folder: &Path, how: &[&str]) -> Result<Child> {
        let words: Vec<&OsStr> = how.iter().map(OsStr::new).collect();
        self.start(&[&[folder.as_os_str()], &words[..]].concat(), Some(&folder.join(LOG)))
    }

    /// Whether the viewer can show something, or write it into the file that is named.
    fn ready(&self, save: Option<&Path>) -> Result<()> {
        let Some(to) = save else { return self.check_with_port() };
        // The viewer's own program writes it, and takes `-` for a name.
        ensure!(!output::is_stdout(to), "a recording is a file: give --save a name");
        self.check()?;
        output::prepare(to)
    }

    /// Shows what the arguments name, or writes it into a file.
    fn show(&self, what: &[&OsStr], save: Option<&Path>) -> Result<ExitCode> {
        let run = |more: &[&OsStr], failed: &str| {
            let status = self.start(&[what, more].concat(), None)?.wait()?;
            ensure!(status.success(), "{failed} ({status})");
            Ok(ExitCode::SUCCESS)
        };
        let Some(to) = save else {
            return run(&[], "the viewer was not opened");
        };
        // The script writes a file of ours, which has the name once it is whole. Ctrl-C ends the script; ours is then taken away.
        let _interrupt = Interrupt::on_ctrl_c()?;
        let saved = replace_with(to, Access::Shared, |file| {
            let ours = format!("/proc/{}/fd/{}", std::process::id(), file.as_raw_fd());
            let ran = run(&["--save".as_ref(), ours.as_ref()], "the viewer's script failed");
            ran.map(drop).map_err(io::Error::other)
        });
        saved.with_context(|| format!("cannot write {}", to.display()))?;
        Ok(ExitCode::SUCCESS)
    }

    /// Shows a course that is described in JSON, or saves what the viewer would show.
    ///
    /// # Errors
    /// No viewer, a port that is taken, a file that cannot be written.
    pub fn course(&self, json: &str, save: Option<&Path>) -> Result<()> {
        self.ready(save)?;
        // The script itself comes over standard input.
        let named = tempfile::Builder::new()
            .prefix("vigil-course-")
            .suffix(".json")
            .tempfile();
        let mut file = named.context("cannot make a file for the course")?;
        file.write_all(json.as_bytes())
            .context("the course could not be written")?;
        self.show(&["--course".as_ref(), file.path().as_os_str()], save)?;
        Ok(())
    }
}

/// Says that the script of a viewer in `folder` failed.
pub(super) fn tell_ended_early(folder: &Path) {
    tell!("vigil: the viewer ended early: see {}", folder.join(LOG).display());
}

/// Opens the viewer.
///
/// # Errors
/// A log that cannot be read, no viewer, a port that is taken.
pub fn run(args: &ViewArgs) -> Result<ExitCode> {
    if args.follow {
        args.viewer.check_with_port()?;
        return args.viewer.show(&[args.log.as_os_str(), "--follow".as_ref()], None);
    }
    let log = find_log(&args.log)?;
    if let Some(to) = &args.save {
        check_not_over(&log, to)?;
    }
    // Another version, or no log at all, is refused here.
    Reader::open(&log)?;
    if args.foxglove {
        let layout = log.with_file_name("foxglove-layout.json");
        output::write(&layout, FOXGLOVE_LAYOUT)?;
        say!("Foxglove: Open local file…  {}", log.display());
        say!("          Layouts → Import from file…  {}", layout.display());
        return Ok(ExitCode::SUCCESS);
    }
    args.viewer.ready(args.save.as_deref())?;
    args.viewer.show(&[log.as_os_str()], args.save.as_deref())
}
