//! What is committed in `generated` is what `proto/vigil/log.proto` makes: the Rust types, and the descriptors that go into every log
//! as its schema. `UPDATE_PROTO=1 cargo test --release -p vigil-log --test generated` writes both.

use prost::Message;
use std::fs;
use std::path::Path;

#[test]
fn the_committed_messages_are_those_of_the_proto_file() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    // The compiler is a library: nobody needs protoc.
    let mut descriptors = protox::compile(["vigil/log.proto"], [root.join("proto")]).expect("log.proto");
    let made = tempfile::tempdir().expect("a folder");
    let mut generator = prost_build::Config::new();
    generator.out_dir(made.path());
    generator.compile_fds(descriptors.clone()).expect("types");
    // What goes into a log is without the places and comments of the source.
    descriptors
        .file
        .iter_mut()
        .for_each(|file| file.source_code_info = None);
    fs::write(made.path().join("log.descriptors"), descriptors.encode_to_vec()).expect("written");
    for name in ["vigil.log.rs", "log.descriptors"] {
        let (made, committed) = (made.path().join(name), root.join("generated").join(name));
        if std::env::var_os("UPDATE_PROTO").is_some() {
            fs::copy(&made, &committed).expect("written");
        }
        let same = fs::read(&made).expect("made") == fs::read(&committed).expect("committed");
        assert!(
            same,
            "generated/{name} is not what log.proto makes: UPDATE_PROTO=1 writes it"
        );
    }
}
