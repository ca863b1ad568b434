//! Makes the log's own messages from `proto/vigil/log.proto`: the Rust types, and the descriptors that go into every log as its
//! schema.

use prost::Message;
use prost_types::FileDescriptorSet;
use std::error::Error;
use std::path::PathBuf;

const FOLDER: &str = "proto";
const FILE: &str = "vigil/log.proto";

fn main() -> Result<(), Box<dyn Error>> {
    println!("cargo:rerun-if-changed={FOLDER}/{FILE}");
    let out = PathBuf::from(std::env::var_os("OUT_DIR").ok_or("cargo says no OUT_DIR")?);
    // The compiler is a library: nobody needs protoc.
    let descriptors = protox::compile([FILE], [FOLDER])?;
    prost_build::Config::new()
        .out_dir(&out)
        .compile_fds(descriptors.clone())?;
    std::fs::write(out.join("log.descriptors"), schema(descriptors))?;
    Ok(())
}

/// What goes into a log: the same without the places and comments of the source.
fn schema(mut descriptors: FileDescriptorSet) -> Vec<u8> {
    for file in &mut descriptors.file {
        file.source_code_info = None;
    }
    descriptors.encode_to_vec()
}
