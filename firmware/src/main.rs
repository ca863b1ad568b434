//! The `firmware` program: the 20 Hz loop on a vehicle.

use clap::Parser;
use std::io::{IsTerminal, Write};
use std::process::ExitCode;
use tracing_subscriber::prelude::*;

/// Fly a vehicle by its depth frames: the fixed-rate loop between shared-memory frames and MAVLink.
#[derive(Parser)]
#[command(name = "firmware", version)]
struct Cli {
    #[command(flatten)]
    args: vigil_firmware::program::FirmwareArgs,
}

fn main() -> ExitCode {
    let cli: Cli = vigil_firmware::removed::parse();
    let diagnostics = tracing_subscriber::fmt::layer()
        .with_writer(std::io::stderr)
        .with_ansi(vigil_firmware::program::colours(std::io::stderr().is_terminal()))
        .with_target(false)
        .without_time()
        .log_internal_errors(false);
    tracing_subscriber::registry()
        .with(diagnostics)
        .with(vigil_firmware::program::diagnostics("info"))
        .init();
    match vigil_firmware::program::run(cli.args) {
        Ok(code) => code,
        Err(error) => {
            // Where nobody listens, nothing can be said.
            let _ = writeln!(
                std::io::stderr(),
                "firmware: {}",
                vigil_firmware::program::in_one_line(&error)
            );
            ExitCode::FAILURE
        }
    }
}
