//! What is committed in `generated` is what the files in `proto` make: the Rust types, and the descriptors that go into every log as
//! its schemas. `UPDATE_PROTO=1 cargo test --release -p vigil-log --test generated` writes them.

use prost::Message;
use std::fs;
use std::path::Path;

/// Compiles a file of `proto` into `folder`: types, and `descriptors`, which are the schema.
fn generate(file: &str, descriptors: &str, folder: &Path) {
    // The compiler is a library: nobody needs protoc.
    let proto = Path::new(env!("CARGO_MANIFEST_DIR")).join("proto");
    let mut set = protox::compile([file], [proto]).expect(file);
    let mut generator = prost_build::Config::new();
    generator.out_dir(folder).compile_well_known_types();
    generator.compile_fds(set.clone()).expect("types");
    // What goes into a log is without the places and comments of the source.
    set.file.iter_mut().for_each(|file| file.source_code_info = None);
    fs::write(folder.join(descriptors), set.encode_to_vec()).expect("written");
}

#[test]
fn the_committed_messages_are_those_of_the_proto_files() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let made = tempfile::tempdir().expect("a folder");
    generate("vigil/log.proto", "log.descriptors", made.path());
    generate("foxglove/messages.proto", "foxglove.descriptors", made.path());
    for name in [
        "vigil.log.rs",
        "log.descriptors",
        "foxglove.rs",
        "google.protobuf.rs",
        "foxglove.descriptors",
    ] {
        let (made, committed) = (made.path().join(name), root.join("generated").join(name));
        if std::env::var_os("UPDATE_PROTO").is_some() {
            fs::copy(&made, &committed).expect("written");
        }
        let same = fs::read(&made).expect("made") == fs::read(&committed).unwrap_or_default();
        assert!(
            same,
            "generated/{name} is not what the files in proto make: UPDATE_PROTO=1 writes it"
        );
    }
}
