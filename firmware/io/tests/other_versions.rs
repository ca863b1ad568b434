//! What a program of another version has put there, of the same name and another type, is refused by name.

mod common;

use common::Instance;
use iceoryx2::prelude::*;
use vigil_io::shared_memory::{DEPTH_TOPIC, Domain, FrameError, FrameSubscriber, LockstepError, LockstepServer};

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
fn frames_of_another_type_are_refused_by_name() {
    let (_instance, domain) = Instance::joined(1);
    let node = other_version(&domain);
    let topic = node.service_builder(&DEPTH_TOPIC.try_into().unwrap());
    let _service = topic.publish_subscribe::<u64>().create().unwrap();
    let refused = FrameSubscriber::create(&domain, DEPTH_TOPIC).err().unwrap();
    assert!(matches!(&refused, FrameError::WrongType { .. }), "{refused}");
}

#[test]
fn a_lockstep_of_another_type_is_refused_by_name() {
    let (_instance, domain) = Instance::joined(2);
    let node = other_version(&domain);
    let exchange = node.service_builder(&"lockstep".try_into().unwrap());
    let _service = exchange.request_response::<u64, u64>().create().unwrap();
    let refused = LockstepServer::create(&domain).err().unwrap();
    assert!(matches!(&refused, LockstepError::WrongType { .. }), "{refused}");
}
