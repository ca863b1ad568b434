//! The frame service between real processes: this test program starts itself again as publisher or subscriber.

mod common;

use common::Instance;
use std::io::{BufRead, BufReader, Write};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::time::{Duration, Instant};
use vigil_io::shared_memory::{DEPTH_TOPIC, Domain, FrameError, FramePublisher, FrameSubscriber};
use vigil_types::DepthFrame;

const CHILD_INSTANCE: &str = "VIGIL_TEST_INSTANCE";
/// Bounds every wait; far above what any of them takes.
const PATIENCE: Duration = Duration::from_secs(20);

fn sealed(sequence: u64) -> Box<DepthFrame> {
    let mut frame = Box::new(DepthFrame::EMPTY);
    frame.header.sequence = sequence;
    frame.depth[sequence as usize % 100] = 0.25;
    frame.seal();
    frame
}

/// Another process that does one thing per line it is given, says so, and can be killed.
struct Process {
    child: Child,
    stdin: ChildStdin,
    stdout: BufReader<std::process::ChildStdout>,
}

impl Process {
    fn start(role: &str, instance: u32) -> Self {
        let mut child = Command::new(std::env::current_exe().unwrap())
            .args(["--exact", role, "--nocapture", "--test-threads=1"])
            .env(CHILD_INSTANCE, instance.to_string())
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut this = Self {
            stdin: child.stdin.take().unwrap(),
            stdout: BufReader::new(child.stdout.take().unwrap()),
            child,
        };
        this.expect("ready");
        this
    }

    fn act(&mut self) {
        writeln!(self.stdin, "act").unwrap();
        self.expect("done");
    }

    fn expect(&mut self, word: &str) {
        let mut line = String::new();
        while !line.contains(word) {
            line.clear();
            assert!(self.stdout.read_line(&mut line).unwrap() > 0, "the process ended");
        }
    }

    fn kill_9(mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }
}

/// In the other process: joins the instance and acts once per line; returns at once in the ordinary run of the tests.
fn act_on_lines<P>(join: impl FnOnce(&Domain) -> P, mut act: impl FnMut(&mut P, u64)) {
    let Ok(instance) = std::env::var(CHILD_INSTANCE) else {
        return;
    };
    let domain = Domain::open(instance.parse().unwrap(), "test-child").unwrap();
    let mut port = join(&domain);
    println!("\nready");
    for (count, line) in std::io::stdin().lines().enumerate() {
        line.unwrap();
        act(&mut port, count as u64);
        println!("done");
    }
}

#[test]
fn child_publisher() {
    act_on_lines(
        |domain| FramePublisher::create(domain, DEPTH_TOPIC).unwrap(),
        |publisher, count| {
            publisher.publish(&sealed(count)).unwrap();
        },
    );
}

#[test]
fn child_subscriber() {
    let mut held = Vec::new();
    act_on_lines(
        |domain| FrameSubscriber::create(domain, DEPTH_TOPIC).unwrap(),
        |subscriber, _| held.extend(subscriber.newest().unwrap()),
    );
}

/// Publishes until a frame arrives: a subscriber and a publisher find each other within their next calls.
fn publish_until_received(publisher: &mut Process, subscriber: &mut FrameSubscriber) -> Box<DepthFrame> {
    let start = Instant::now();
    while start.elapsed() < PATIENCE {
        publisher.act();
        if let Some(frame) = subscriber.newest().unwrap() {
            return Box::new(frame.clone());
        }
    }
    panic!("no frame arrived");
}

#[test]
fn a_killed_and_restarted_publisher_serves_the_same_subscriber_again() {
    let (instance, domain) = Instance::joined(0);
    let mut subscriber = FrameSubscriber::create(&domain, DEPTH_TOPIC).unwrap();
    for _ in 0..2 {
        let mut publisher = Process::start("child_publisher", instance.0);
        let frame = publish_until_received(&mut publisher, &mut subscriber);
        assert_eq!(frame.check(0), Ok(()));
        let again = publish_until_received(&mut publisher, &mut subscriber);
        assert!(again.header.sequence > frame.header.sequence);
        publisher.kill_9();
        assert!(subscriber.newest().unwrap().is_none(), "a dead publisher sends nothing");
    }
}

#[test]
fn a_killed_subscriber_does_not_disturb_the_publisher() {
    let (instance, domain) = Instance::joined(1);
    let mut publisher = FramePublisher::create(&domain, DEPTH_TOPIC).unwrap();
    for _ in 0..2 {
        let mut subscriber = Process::start("child_subscriber", instance.0);
        assert_eq!(publisher.publish(&sealed(0)).unwrap(), 1);
        subscriber.act();
        // It dies holding a frame.
        subscriber.kill_9();
        for sequence in 1..20 {
            publisher.publish(&sealed(sequence)).unwrap();
        }
    }
}

fn both_ends(domain: &Domain) -> (FramePublisher, FrameSubscriber) {
    let publisher = FramePublisher::create(domain, DEPTH_TOPIC).unwrap();
    (publisher, FrameSubscriber::create(domain, DEPTH_TOPIC).unwrap())
}

#[test]
fn the_newest_frame_wins_and_is_written_where_it_is_read() {
    let (_instance, domain) = Instance::joined(2);
    let (mut publisher, mut subscriber) = both_ends(&domain);
    assert!(subscriber.newest().unwrap().is_none());
    for sequence in 0..5 {
        assert_eq!(publisher.publish(&sealed(sequence)).unwrap(), 1);
    }
    let first = subscriber.newest().unwrap().unwrap();
    assert_eq!(*first, *sealed(4), "every bit arrives");
    assert!(subscriber.newest().unwrap().is_none(), "each frame arrives once");
    // A reader that still holds a frame gets the next one all the same.
    let fill = |frame: &mut DepthFrame| {
        assert_eq!(*frame, DepthFrame::EMPTY);
        frame.clone_from(&sealed(5));
    };
    publisher.publish_with(fill).unwrap();
    let next = subscriber.newest().unwrap().unwrap();
    assert_eq!((next.header.sequence, next.check(0)), (5, Ok(())));
    assert_eq!(first.header.sequence, 4, "a borrowed frame stays as it was");
}

#[test]
fn a_second_publisher_is_refused_by_name_and_other_instances_are_free() {
    let (instance, domain) = Instance::joined(4);
    let publisher = FramePublisher::create(&domain, DEPTH_TOPIC).unwrap();
    // From another node, as another process would.
    let other_node = Domain::open(instance.0, "test-2").unwrap();
    let refused = FramePublisher::create(&other_node, DEPTH_TOPIC).err().unwrap();
    assert!(matches!(&refused, FrameError::AlreadyPublished { .. }), "{refused}");
    assert!(refused.to_string().contains("--instance"), "{refused}");

    let (_other_instance, elsewhere) = Instance::joined(5);
    let (mut second, mut deaf) = both_ends(&elsewhere);
    drop(publisher);
    let mut first = FramePublisher::create(&other_node, DEPTH_TOPIC).unwrap();
    assert_eq!(
        first.publish(&sealed(1)).unwrap(),
        0,
        "instances do not hear each other"
    );
    assert!(deaf.newest().unwrap().is_none());
    assert_eq!(second.publish(&sealed(2)).unwrap(), 1);
    assert_eq!(deaf.newest().unwrap().unwrap().header.sequence, 2);
}
