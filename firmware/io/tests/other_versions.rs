//! What others have put there: of another version, of the same name and another type, it is refused by name; what a process
//! left that ended while it joined is removed.

mod common;

use common::Instance;
use iceoryx2::prelude::*;
use vigil_io::shared_memory::{DEPTH_TOPIC, Domain, FrameSubscriber, LockstepServer};

/// That program, in the domain's place.
fn other_version(domain: &Domain) -> Node<ipc::Service> {
    let mut config = Config::default();
    let (uid, instance) = (rustix::process::getuid().as_raw(), domain.instance());
    let root = format!("/dev/shm/vigil-{uid}/{instance}");
    config.global.set_root_path(&Path::new(root.as_bytes()).unwrap());
    config.global.prefix = FileName::new(format!("vigil{uid}_{instance}_").as_bytes()).unwrap();
    NodeBuilder::new().config(&config).create().unwrap()
}

#[test]
fn frames_and_a_lockstep_of_another_type_are_refused_by_name() {
    let (_instance, domain) = Instance::joined(1);
    let node = other_version(&domain);
    let service = |name: &str| node.service_builder(&name.try_into().unwrap());
    let _frames = service(DEPTH_TOPIC).publish_subscribe::<u64>().create().unwrap();
    let _lockstep = service("lockstep").request_response::<u64, u64>().create().unwrap();
    let frames = FrameSubscriber::create(&domain, DEPTH_TOPIC).err().unwrap().to_string();
    let lockstep = LockstepServer::create(&domain).err().unwrap().to_string();
    for refused in [frames, lockstep] {
        assert!(refused.contains("carries another type of data"), "{refused}");
    }
}

#[test]
fn a_process_that_ended_while_it_joined_keeps_nobody_out() {
    let (instance, domain) = Instance::joined(3);
    drop(domain);
    let prefix = format!("vigil{}_{}_", rustix::process::getuid().as_raw(), instance.0);
    let mut files = std::fs::read_dir("/dev/shm").unwrap().map(|entry| entry.unwrap());
    let first = files.find(|file| file.file_name().to_string_lossy().starts_with(&prefix));
    // As it is before it is filled in.
    let not_yet = std::os::unix::fs::PermissionsExt::from_mode(0o200);
    std::fs::set_permissions(first.unwrap().path(), not_yet).unwrap();
    assert!(Domain::open(instance.0, "test").is_ok());
}
