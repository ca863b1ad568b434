//! What all commands share in talking to people: exit codes, colours, tracing.

use std::io::IsTerminal;
use tracing_subscriber::EnvFilter;

/// The command could not do its work (bad arguments, missing file, port in use).
pub const EXIT_ERROR: u8 = 1;
/// A comparison or check failed (replay differs).
pub const EXIT_DIFFERS: u8 = 3;

/// Starts diagnostics on standard error; `RUST_LOG` overrides `verbosity`.
pub fn start_tracing(verbosity: u8) {
    let default = ["warn", "info", "debug"][usize::from(verbosity.min(2))];
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new(default));
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal())
        .with_target(false)
        .init();
}

/// Paints text for a terminal; plain text anywhere else, or when `NO_COLOR` is set.
pub struct Paint {
    on: bool,
}

impl Paint {
    /// Colours for standard output.
    pub fn stdout() -> Self {
        Self {
            on: std::io::stdout().is_terminal() && std::env::var_os("NO_COLOR").is_none(),
        }
    }

    /// Green when `good`, red otherwise.
    pub fn verdict(&self, good: bool, text: &str) -> String {
        match (self.on, good) {
            (false, _) => text.to_owned(),
            (true, true) => format!("\x1b[32m{text}\x1b[0m"),
            (true, false) => format!("\x1b[31m{text}\x1b[0m"),
        }
    }
}

/// The commit of the working tree, if there is one and git is there.
pub fn git_commit() -> Option<String> {
    let output = std::process::Command::new("git")
        .args(["describe", "--always", "--dirty", "--abbrev=40"])
        .output()
        .ok()?;
    let text = String::from_utf8(output.stdout).ok()?;
    (output.status.success() && !text.trim().is_empty()).then(|| text.trim().to_owned())
}

/// Colour of a range over full scale in pictures of frames: near is bright, as in the contrast that the actor sees.
pub fn range_grey(range: f32) -> [u8; 3] {
    [(255.0 / (1.0 + range * 100.0 / 3.0)) as u8; 3]
}
