//! SHA-256 over all sources that `vigil` and `vigil-lab` are made of, so that each knows whether the other is of the same.

use sha2::{Digest, Sha256};
use std::path::{Path, PathBuf};

/// Folders at the top that hold what is compiled into the programs.
const FOLDERS: [&str; 4] = ["firmware", "detector", "sim_bridge", "tools"];

fn main() {
    let top = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let mut files = vec![top.join("Cargo.lock"), top.join("Cargo.toml")];
    for folder in FOLDERS {
        gather(&top.join(folder), &mut files);
    }
    files.sort();
    let mut digest = Sha256::new();
    for file in &files {
        println!("cargo::rerun-if-changed={}", file.display());
        digest.update(file.strip_prefix(&top).unwrap_or(file).as_os_str().as_encoded_bytes());
        digest.update(std::fs::read(file).unwrap_or_default());
    }
    let hex: String = digest.finalize().iter().map(|byte| format!("{byte:02x}")).collect();
    println!("cargo::rustc-env=VIGIL_SOURCES={hex}");
}

/// Rust files and frozen networks below a folder.
fn gather(folder: &Path, files: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        let path = entry.path();
        if path.is_dir() {
            let name = entry.file_name();
            if !["target", "tests", "benches"].iter().any(|left_out| name == *left_out) {
                gather(&path, files);
            }
        } else if path
            .extension()
            .is_some_and(|ending| ending == "rs" || ending == "safetensors")
        {
            files.push(path);
        }
    }
}
