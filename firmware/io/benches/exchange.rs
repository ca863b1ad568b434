//! What a frame and a lockstep step cost between two threads that meet in shared memory as two processes do.

#[path = "../tests/common/mod.rs"]
mod common;

use common::Instance;
use std::time::Duration;
use vigil_io::shared_memory::{
    DEPTH_TOPIC, Domain, FramePublisher, FrameSubscriber, LockstepClient, LockstepServer, Served,
};
use vigil_types::{Datagrams, DepthFrame, FrameKey};

fn main() {
    divan::main();
}

#[divan::bench]
fn publish_and_receive_a_frame(bencher: divan::Bencher) {
    let (_instance, domain) = Instance::joined(0);
    let mut publisher = FramePublisher::create(&domain, DEPTH_TOPIC).unwrap();
    let mut subscriber = FrameSubscriber::create(&domain, DEPTH_TOPIC).unwrap();
    let mut frame = Box::new(DepthFrame::EMPTY);
    frame.seal();
    bencher.bench_local(|| {
        publisher.publish(&frame).unwrap();
        subscriber.newest().unwrap().unwrap().header.checksum
    });
}

/// What a driver and the firmware each spend on a frame, without and with a key.
#[divan::bench]
fn checksum_of_a_frame(bencher: divan::Bencher) {
    let frame = Box::new(DepthFrame::EMPTY);
    bencher.bench_local(|| divan::black_box(&*frame).compute_checksum());
}

#[divan::bench]
fn authentication_tag_of_a_frame(bencher: divan::Bencher) {
    let (frame, key) = (Box::new(DepthFrame::EMPTY), FrameKey::new(&[1; 32], 1, b"boot"));
    bencher.bench_local(|| key.tag(divan::black_box(&frame)));
}

#[divan::bench(args = [false, true])]
fn lockstep_exchange(bencher: divan::Bencher, with_frame: bool) {
    let (instance, domain) = Instance::joined(1);
    let number = instance.0;
    let firmware = std::thread::spawn(move || {
        let domain = Domain::open(number, "bench-firmware").unwrap();
        let mut server = LockstepServer::create(&domain).unwrap();
        let sent = Datagrams::default();
        while server.serve(Duration::from_secs(10), || false, |_| &sent).unwrap() == Served::Step {}
    });
    let mut client = LockstepClient::connect(&domain, Duration::from_secs(10), || false).unwrap();
    let (received, mut sent) = (Datagrams::default(), Datagrams::default());
    let frame = Box::new(DepthFrame::EMPTY);
    bencher.bench_local(|| {
        client
            .exchange(0, 0, with_frame.then_some(&*frame), &received, &mut sent)
            .unwrap()
    });
    client.finish(0).unwrap();
    firmware.join().unwrap();
}
