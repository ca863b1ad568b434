//! The lockstep exchange between two threads that share nothing but the instance number.

mod common;

use common::Instance;
use std::thread;
use std::time::Duration;
use vigil_io::shared_memory::{Domain, LockstepClient, LockstepError, LockstepServer, Served, StepRequest};
use vigil_types::{Datagrams, DepthFrame};

const PATIENCE: Duration = Duration::from_secs(20);

/// A firmware that echoes: sends back what it received, then a datagram with the time and the frame's sequence. Ends
/// when asked, returns the number of steps it answered.
fn echo(instance: u32) -> u64 {
    let domain = Domain::open(instance, "test-firmware").unwrap();
    let mut server = LockstepServer::create(&domain).unwrap();
    let mut sent = Datagrams::default();
    for answered in 0.. {
        let sent = &mut sent;
        let served = server.serve(
            PATIENCE,
            || false,
            move |request: StepRequest<'_>| {
                sent.clear();
                for (link, bytes) in request.received.iter() {
                    assert!(sent.push(link, bytes));
                }
                assert!(sent.push(9, &summary(request.now_ns, request.frame)));
                &*sent
            },
        );
        if served.unwrap() == Served::Finished {
            return answered;
        }
    }
    unreachable!()
}

fn summary(now_ns: u64, frame: Option<&DepthFrame>) -> Vec<u8> {
    let sequence = frame.map_or(u64::MAX, |f| f.header.sequence);
    [now_ns.to_le_bytes(), sequence.to_le_bytes()].concat()
}

#[test]
fn each_step_is_answered_with_its_own_data_until_the_simulator_says_that_it_is_over() {
    let (instance, domain) = Instance::joined(0);
    let number = instance.0;
    let firmware = thread::spawn(move || echo(number));
    let mut client = LockstepClient::connect(&domain, PATIENCE, || false).unwrap();
    let mut sent = Datagrams::default();
    let mut frame = Box::new(DepthFrame::EMPTY);
    for step in 0..200 {
        let mut received = Datagrams::default();
        for i in 0..step % 5 {
            assert!(received.push(i as u8, &vec![step as u8; 10 * i as usize]));
        }
        frame.header.sequence = step;
        let new_frame = (step % 2 == 0).then_some(&*frame);
        client
            .exchange(step, step * 50, new_frame, &received, &mut sent)
            .unwrap();
        assert!(received.push(9, &summary(step * 50, new_frame)));
        assert_eq!(sent, received);
    }
    client.finish(200).unwrap();
    assert_eq!(firmware.join().unwrap(), 200);
}

#[test]
fn a_time_out_names_who_is_missing() {
    let (instance, domain) = Instance::joined(1);
    let nobody = LockstepClient::connect(&domain, Duration::from_millis(60), || false);
    let nobody = nobody.err().unwrap().to_string();
    assert!(nobody.starts_with("no firmware came"), "{nobody}");

    // A firmware that answers one step and then falls silent without going.
    let (quit, until_quit) = std::sync::mpsc::channel::<()>();
    let number = instance.0;
    let firmware = thread::spawn(move || {
        let domain = Domain::open(number, "test-firmware").unwrap();
        let mut server = LockstepServer::create(&domain).unwrap();
        let sent = Datagrams::default();
        assert_eq!(server.serve(PATIENCE, || false, |_| &sent).unwrap(), Served::Step);
        until_quit.recv().unwrap();
    });
    let client = LockstepClient::connect(&domain, PATIENCE, || false);
    drop(client);
    let mut client = LockstepClient::connect(&domain, Duration::from_millis(500), || false).unwrap();
    let (received, mut sent) = (Datagrams::default(), Datagrams::default());
    client.exchange(122, 0, None, &received, &mut sent).unwrap();
    let silent = client.exchange(123, 0, None, &received, &mut sent).unwrap_err();
    assert_eq!(silent.to_string(), "firmware did not answer step 123 within 0.5 s");
    // Who interrupts it waits neither for that firmware nor for one that is not there.
    drop(client);
    let calls = std::cell::Cell::new(0);
    let interrupted = move || calls.replace(calls.get() + 1) > 0;
    let mut client = LockstepClient::connect(&domain, PATIENCE, interrupted).unwrap();
    let cancelled = client.exchange(124, 0, None, &received, &mut sent).unwrap_err();
    assert!(matches!(cancelled, LockstepError::Cancelled), "{cancelled}");
    drop(client);
    quit.send(()).unwrap();
    firmware.join().unwrap();
    let cancelled = LockstepClient::connect(&domain, PATIENCE, || true).err().unwrap();
    assert!(matches!(cancelled, LockstepError::Cancelled), "{cancelled}");

    let mut server = LockstepServer::create(&domain).unwrap();
    let unused = |_: StepRequest<'_>| -> &Datagrams { panic!("no step was sent") };
    let absent = server.serve(Duration::from_millis(60), || false, unused).unwrap_err();
    assert_eq!(absent.to_string(), "simulator did not send step 0 within 0.06 s");
    assert_eq!(server.serve(PATIENCE, || true, unused).unwrap(), Served::Cancelled);
}

#[test]
fn each_role_exists_once() {
    let (instance, domain) = Instance::joined(2);
    let _server = LockstepServer::create(&domain).unwrap();
    let second = LockstepServer::create(&domain).err().unwrap().to_string();
    assert!(second.starts_with("another firmware already runs lockstep"), "{second}");
    let _client = LockstepClient::connect(&domain, PATIENCE, || false).unwrap();
    let second = LockstepClient::connect(&domain, PATIENCE, || false).err().unwrap();
    assert!(second.to_string().starts_with("another simulator already"), "{second}");
    // In real time too, until the first has ended.
    let flying = Domain::open_alone(instance.0, "firmware").unwrap();
    let second = Domain::open_alone(instance.0, "firmware").unwrap_err().to_string();
    assert!(second.contains("another firmware already runs"), "{second}");
    drop(flying);
    Domain::open_alone(instance.0, "firmware").unwrap();
}
