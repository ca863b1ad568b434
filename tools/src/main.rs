//! The `vigil` program.

fn main() -> std::process::ExitCode {
    vigil_tools::cli::main()
}
