//! The `firmware` program as a process of its own.

mod common;

use common::{LOITER, PATIENCE, TestVehicle, arrived, free_port};
use std::net::UdpSocket;
use std::os::unix::net::UnixDatagram;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};
use vigil_firmware::{FirmwareConfig, replay};
use vigil_io::clock::monotonic_ns;
use vigil_io::shared_memory::{DEPTH_TOPIC, Domain, FrameError, FramePublisher, remove_leftovers};
use vigil_log::{LogEnd, Reader};

fn firmware(arguments: &[&str]) -> Command {
    let mut command = Command::new("nohup");
    command
        .arg(env!("CARGO_BIN_EXE_firmware"))
        .args(arguments)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    command
}

/// An instance that the program accepts and nobody uses at the moment, with its publisher. None is given twice: a test may
/// end its publisher and begin another.
fn free_instance() -> (u32, Domain, FramePublisher) {
    static GIVEN: AtomicU32 = AtomicU32::new(0);
    let first = std::process::id() % 40;
    for _ in 0..40 {
        let number = 60 + (first + GIVEN.fetch_add(1, Ordering::Relaxed)) % 40;
        let domain = Domain::open(number, "test-simulator").unwrap();
        match FramePublisher::create(&domain, DEPTH_TOPIC) {
            Ok(publisher) => return (number, domain, publisher),
            Err(FrameError::AlreadyPublished { .. }) => {}
            Err(other) => panic!("{other}"),
        }
    }
    panic!("every instance is in use");
}

/// The simulator's side of a flight, and the program.
struct Flight {
    vehicle: TestVehicle,
    socket: UdpSocket,
    publisher: Option<FramePublisher>,
    domain: Option<Domain>,
    instance: u32,
    child: Option<Child>,
}

impl Flight {
    fn start(log: &Path, further: &[&str]) -> Self {
        let (instance, domain, publisher) = free_instance();
        let socket = common::socket();
        socket.connect(("127.0.0.1", free_port())).unwrap();
        let mut flight = Self {
            vehicle: TestVehicle::hovering(2.5),
            socket,
            publisher: Some(publisher),
            domain: Some(domain),
            instance,
            child: None,
        };
        flight.restart(log, further);
        flight
    }

    /// The same command again, as somebody would type it.
    fn restart(&mut self, log: &Path, further: &[&str]) {
        let port = self.socket.peer_addr().unwrap().port();
        let child = firmware(&["--engage", "auto", "--goal", "20,5", "--priority", "0"])
            .args(["--instance", &self.instance.to_string()])
            .args(["--link", &format!("udpin://127.0.0.1:{port}")])
            .arg("--log")
            .arg(log)
            .args(further)
            .spawn()
            .unwrap();
        self.child = Some(child);
    }

    /// A twentieth of a second of flight.
    fn step(&mut self) {
        let now_ns = monotonic_ns();
        if let Some(publisher) = &mut self.publisher {
            publisher.publish(&self.vehicle.frame(now_ns)).unwrap();
        }
        for (_, datagram) in self.vehicle.telemetry().iter() {
            // Refused while the program is not there.
            let _ = self.socket.send(datagram);
        }
        self.hear();
        self.vehicle.advance();
        std::thread::sleep(Duration::from_millis(50));
    }

    fn hear(&mut self) {
        for datagram in arrived(&self.socket) {
            self.vehicle.hear(&datagram);
        }
    }

    fn until(&mut self, what: &str, mut happened: impl FnMut(&TestVehicle) -> bool) {
        let begun = Instant::now();
        while !happened(&self.vehicle) {
            assert!(begun.elapsed() < PATIENCE, "{what}: never");
            self.step();
        }
    }

    fn until_text(&mut self, text: &str) {
        self.vehicle.heard.clear();
        self.until(text, |vehicle| {
            only!(&vehicle.heard, STATUSTEXT).any(|m| m.text.to_str().unwrap().contains(text))
        });
    }

    /// The vehicle flies on until the program has ended.
    fn signal_and_fly_on(&mut self, signal: rustix::process::Signal) -> Output {
        let mut child = self.child.take().unwrap();
        rustix::process::kill_process(rustix::process::Pid::from_child(&child), signal).unwrap();
        while child.try_wait().unwrap().is_none() {
            self.step();
        }
        self.hear();
        child.wait_with_output().unwrap()
    }
}

impl Drop for Flight {
    fn drop(&mut self) {
        if let Some(mut child) = self.child.take() {
            let _ = child.kill();
            let _ = child.wait();
        }
        self.publisher = None;
        self.domain = None;
        let _ = remove_leftovers(self.instance);
    }
}

fn moving(vehicle: &TestVehicle) -> bool {
    vehicle.setpoints.last().is_some_and(|s| s.vx > 0.3)
}

fn said(output: &Output) -> String {
    let [out, err] = [&output.stdout, &output.stderr].map(|bytes| String::from_utf8_lossy(bytes));
    format!("{}\n{out}\n{err}", output.status)
}

fn only_log(folder: &Path) -> std::path::PathBuf {
    let mut logs: Vec<_> = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|e| e == "mcap"))
        .collect();
    assert_eq!(logs.len(), 1, "{logs:?}");
    logs.remove(0)
}

#[test]
fn it_flies_holds_when_the_simulator_goes_flies_on_when_it_returns_and_ends_with_zeros_and_a_whole_log() {
    let folder = tempfile::tempdir().unwrap();
    let mut flight = Flight::start(folder.path(), &[]);
    flight.until("guided flight", moving);

    // The simulator's frames end: hold, named.
    flight.publisher = None;
    flight.until_text("guidance: hold (stale frame)");
    let stopped = flight.vehicle.setpoints.last().unwrap();
    assert_eq!((stopped.vx, stopped.vy, stopped.yaw_rate), (0.0, 0.0, 0.0));

    // A new publisher whose sequence starts at 0 again: flight.
    flight.publisher = Some(FramePublisher::create(flight.domain.as_ref().unwrap(), DEPTH_TOPIC).unwrap());
    flight.until_text("guidance: guided");
    flight.until("guided flight again", moving);

    // It is ordered to hold while it is still sent zeros, and seen to: a stream that only ceases would make a PX4 return.
    let ended = flight.signal_and_fly_on(rustix::process::Signal::TERM);
    assert!(ended.status.success(), "{}", said(&ended));
    let last = flight.vehicle.setpoints.last().unwrap();
    assert_eq!((last.vx, last.vy, last.yaw_rate), (0.0, 0.0, 0.0));
    assert_eq!(flight.vehicle.mode, LOITER);
    let summary = String::from_utf8_lossy(&ended.stdout);
    let words = "ended in |holds by itself|steps|missed|p50|p99|max|frames|refused|log";
    for word in words.split('|') {
        assert!(summary.contains(word), "`{word}` in {summary}");
    }

    // A live flight replays to the byte, the request to end included.
    let report = replay(&mut Reader::open(&only_log(folder.path())).unwrap()).unwrap();
    assert!(report.is_equal(), "{report}");
    assert_eq!(report.log_end, Some(LogEnd::Closed { dropped: 0 }));
}

#[test]
fn a_vehicle_that_a_person_took_over_is_not_taken_by_a_firmware_that_is_killed_and_started_again() {
    const POSITION: (u8, u8) = (3, 0);
    let folder = tempfile::tempdir().unwrap();
    let (log, state) = (folder.path().join("log"), folder.path().join("state"));
    let mut flight = Flight::start(&log, &["--state", state.to_str().unwrap()]);
    flight.until("guided flight", moving);
    flight.vehicle.mode = POSITION;
    flight.until_text("guidance: standby");
    let file = state.join(format!("firmware{}.toml", flight.instance));
    flight.until("the state", |_| file.exists());
    flight.signal_and_fly_on(rustix::process::Signal::KILL);

    // The pilot lets go: the vehicle holds its position, where a firmware that knows nothing would take it.
    flight.vehicle.mode = LOITER;
    flight.restart(&folder.path().join("again"), &["--state", state.to_str().unwrap()]);
    flight.until_text("a person has the vehicle");
    flight.vehicle.setpoints.clear();
    flight.vehicle.heard.clear();
    for _ in 0..40 {
        flight.step();
    }
    let commanded = only!(&flight.vehicle.heard, COMMAND_LONG).any(|c| (c.command as u16) < 500);
    assert!(!commanded && flight.vehicle.setpoints.is_empty() && flight.vehicle.mode == LOITER);
    // A limit of its files' size ends its log, not the program.
    let none = rustix::process::Rlimit {
        current: Some(0),
        ..rustix::process::getrlimit(rustix::process::Resource::Fsize)
    };
    let pid = rustix::process::Pid::from_child(flight.child.as_ref().unwrap());
    rustix::process::prlimit(Some(pid), rustix::process::Resource::Fsize, none).unwrap();
    let ended = flight.signal_and_fly_on(rustix::process::Signal::TERM);
    let words = said(&ended);
    assert!(
        ended.status.success() && words.contains("cannot be written any more"),
        "{words}"
    );
    assert!(words.contains("a person took the vehicle over"), "{words}");
}

/// What a service manager hears from now on for `patience`, one line after the other.
fn hear_service(manager: &UnixDatagram, patience: Duration) -> Vec<String> {
    let begun = Instant::now();
    let mut heard = Vec::new();
    let mut buffer = [0; 512];
    while let Some(left) = patience.checked_sub(begun.elapsed()).filter(|left| !left.is_zero()) {
        manager.set_read_timeout(Some(left)).unwrap();
        if let Ok(len) = manager.recv(&mut buffer) {
            heard.extend(std::str::from_utf8(&buffer[..len]).unwrap().lines().map(str::to_owned));
        }
    }
    heard
}

/// Waits until a service manager hears `what`; returns all that it heard.
fn until_service(manager: &UnixDatagram, what: &str) -> Vec<String> {
    let begun = Instant::now();
    let mut heard = Vec::new();
    while !heard.iter().any(|line| line == what) {
        assert!(begun.elapsed() < PATIENCE, "{what}: never, but {heard:?}");
        heard.extend(hear_service(manager, Duration::from_millis(100)));
    }
    heard
}

#[test]
fn a_service_manager_hears_that_it_is_ready_that_its_loop_advances_and_that_it_ends() {
    let folder = tempfile::tempdir().unwrap();
    let socket = folder.path().join("notify");
    let manager = UnixDatagram::bind(&socket).unwrap();
    let (instance, domain, publisher) = free_instance();
    let child = firmware(&["--priority", "0", "--instance", &instance.to_string()])
        .args(["--link", &format!("udpin://127.0.0.1:{}", free_port())])
        .env("NOTIFY_SOCKET", &socket)
        .env("WATCHDOG_USEC", "2000000")
        .spawn()
        .unwrap();
    let heard = until_service(&manager, "STATUS=standby");
    assert_eq!(heard[0], "READY=1", "{heard:?}");
    let alive = |lines: &[String]| lines.iter().filter(|line| *line == "WATCHDOG=1").count();
    let heard = hear_service(&manager, Duration::from_secs(2));
    assert!(alive(&heard) >= 2, "{heard:?}");

    // The loop's thread stands still, the others run.
    let pid = rustix::process::Pid::from_child(&child);
    if let Some(stopped) = StoppedThread::stop(pid) {
        hear_service(&manager, Duration::from_millis(600));
        let heard = hear_service(&manager, Duration::from_secs(1));
        assert!(heard.is_empty(), "{heard:?}");
        drop(stopped);
        until_service(&manager, "WATCHDOG=1");
    } else {
        eprintln!("left out: no thread may be stopped here");
    }

    // The end of its terminal is not that of a program that was begun with `nohup`.
    rustix::process::kill_process(pid, rustix::process::Signal::HUP).unwrap();
    let heard = hear_service(&manager, Duration::from_millis(600));
    assert!(!heard.iter().any(|line| line == "STOPPING=1"), "{heard:?}");
    rustix::process::kill_process(pid, rustix::process::Signal::TERM).unwrap();
    let heard = until_service(&manager, "STOPPING=1");
    assert_eq!(heard.last().unwrap(), "STOPPING=1");
    let ended = child.wait_with_output().unwrap();
    assert!(ended.status.success(), "{}", said(&ended));
    assert!(hear_service(&manager, Duration::from_millis(100)).is_empty());
    drop((publisher, domain));
    let _ = remove_leftovers(instance);
}

/// The first thread of a child of ours, stopped alone as a debugger does it; goes on when dropped.
struct StoppedThread(libc::pid_t);

impl StoppedThread {
    /// `None` where the system forbids it.
    fn stop(pid: rustix::process::Pid) -> Option<Self> {
        let thread = pid.as_raw_nonzero().get();
        let none = std::ptr::null_mut::<libc::c_void>();
        // SAFETY: these requests write nothing to this process's memory.
        let ordered = unsafe {
            libc::ptrace(libc::PTRACE_SEIZE, thread, none, none) == 0
                && libc::ptrace(libc::PTRACE_INTERRUPT, thread, none, none) == 0
        };
        // SAFETY: no status is written; __WALL as the thread is another's.
        let stopped = ordered && unsafe { libc::waitpid(thread, std::ptr::null_mut(), libc::__WALL) } == thread;
        stopped.then_some(Self(thread))
    }
}

impl Drop for StoppedThread {
    fn drop(&mut self) {
        let none = std::ptr::null_mut::<libc::c_void>();
        // SAFETY: as above.
        unsafe { libc::ptrace(libc::PTRACE_DETACH, self.0, none, none) };
    }
}

#[test]
fn the_configuration_that_it_prints_is_one_it_takes_and_its_help_shows_ranges_and_defaults() {
    let printed = firmware(&["--print-config"]).output().unwrap();
    assert_eq!(printed.status.code(), Some(0));
    let text = String::from_utf8(printed.stdout).unwrap();
    assert_eq!(FirmwareConfig::from_toml(&text), Ok(FirmwareConfig::default()));
    assert!(
        text.contains("goal_radius_m = 1.0") && text.contains("0.1 to 100 m"),
        "{text}"
    );

    let help = firmware(&["--help"]).output().unwrap();
    let help = String::from_utf8(help.stdout).unwrap();
    for part in [
        "0.1 to 1000 m) [default: 2.5]",
        "[default: recover]",
        "with or without the detector",
        "(0.01 to 0.999)",
    ] {
        let flowing: String = help.split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(flowing.contains(part), "{part}: {help}");
    }
}

#[test]
fn what_is_wrong_is_reported_in_one_place_with_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("wrong.toml");
    std::fs::write(&file, "[limits]\nframe_age_s = 0.25\nframe_age_ms = 250\n").unwrap();
    let refused = |arguments: &[&str], code: i32, expected: &[&str]| {
        let output = firmware(arguments).output().unwrap();
        let text = said(&output);
        assert_eq!(output.status.code(), Some(code), "{text}");
        assert!(
            expected.iter().all(|words| text.contains(words)),
            "{expected:?}: {text}"
        );
    };
    let config = ["--config", file.to_str().unwrap()];
    refused(&config, 1, &["wrong.toml", "line 3", "frame_age_ms"]);
    for (arguments, expected) in [
        (["--goal", "here"], "NORTH,EAST"),
        (["--print-config", "--lockstep"], "cannot be used with"),
        (["--height", "-3"], "0.1 to 1000"),
        (["--instance", "100"], "0 to 99"),
        (["--link", "14030"], "udpin://"),
        (["--vehicle", "px5"], "ardupilot"),
    ] {
        refused(&arguments, 2, &[expected]);
    }

    let (instance, _domain, _publisher) = free_instance();
    let taken = UdpSocket::bind("127.0.0.1:0").unwrap();
    let url = format!("udpin://{}", taken.local_addr().unwrap());
    let number = instance.to_string();
    for (arguments, expected) in [
        (["--link", &url].as_slice(), "in use by another process"),
        (&["--link", "udpout://no..host:1"], "the host is not known"),
        (
            &["--log", file.to_str().unwrap()],
            "give a directory that can be written",
        ),
        (
            &["--lockstep", "--lockstep-timeout", "1"],
            "simulator did not send step 0 within 1 s",
        ),
    ] {
        refused(&[&["--instance", &number], arguments].concat(), 1, &[expected]);
    }
}
