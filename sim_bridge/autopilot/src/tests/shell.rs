//! The shell, by packets.

use crate::testing::*;

fn write(b: &mut Bench, text: &[u8], flags: SerialControlFlag) {
    for chunk in text.chunks(70) {
        let mut data = [0; 70];
        data[..chunk.len()].copy_from_slice(chunk);
        let device = SerialControlDev::SERIAL_CONTROL_DEV_SHELL;
        b.tell(message!(SERIAL_CONTROL, device, flags, count = chunk.len() as u8, data));
    }
}

fn answer(b: &Bench) -> String {
    let mut bytes = Vec::new();
    for s in b.all::<SERIAL_CONTROL_DATA>(API) {
        assert_eq!((s.target_system, s.target_component), (245, 190));
        assert_eq!(s.flags, SerialControlFlag::SERIAL_CONTROL_FLAG_REPLY);
        bytes.extend_from_slice(&s.data[..usize::from(s.count)]);
    }
    String::from_utf8(bytes).expect("text")
}

fn run(b: &mut Bench, line: &str) -> String {
    b.sent.clear();
    let respond = SerialControlFlag::SERIAL_CONTROL_FLAG_RESPOND;
    write(b, format!("{line}\n").as_bytes(), respond);
    let answer = answer(b);
    answer.strip_suffix("pxh> ").expect("ends with a prompt").to_owned()
}

#[test]
fn parameters_are_shown_and_set_with_the_checks_of_the_protocol() {
    let mut b = Bench::new();
    assert_eq!(run(&mut b, "param show MIS_TAKEOFF_ALT"), "MIS_TAKEOFF_ALT: 2.5\n");
    assert_eq!(run(&mut b, "param set MIS_TAKEOFF_ALT 4"), "MIS_TAKEOFF_ALT: 4.0\n");
    // Ground stations hear of it.
    let is_found = b
        .messages(GCS)
        .any(|m| matches!(m, MavMessage::PARAM_VALUE(v) if v.param_value == 4.0));
    assert!(is_found);
    assert!(run(&mut b, "param set MIS_TAKEOFF_ALT 4000").contains("is not within"));
    assert!(run(&mut b, "param set MIS_TAKEOFF_ALT NaN").contains("is not within"));
    assert!(run(&mut b, "param set MIS_TAKEOFF_ALT high").contains("not a number"));
    assert!(run(&mut b, "param set COM_OBL_RC_ACT 4.5").contains("not a number"));
    assert!(run(&mut b, "param set NO_SUCH 1").contains("there is no parameter NO_SUCH"));
    assert_eq!(run(&mut b, "param show MIS_TAKEOFF_ALT"), "MIS_TAKEOFF_ALT: 4.0\n");
    let speeds = run(&mut b, "param show MPC_*_VEL_MAX*");
    assert_eq!(speeds.lines().count(), 3, "{speeds}");
    let all = run(&mut b, "param show");
    assert_eq!(all.lines().count(), parameter_table().len());
}

#[test]
fn the_vehicle_is_commanded_as_by_messages_and_no_reboot_in_the_air() {
    let mut b = Bench::new();
    assert_eq!(run(&mut b, "commander takeoff"), "done\n");
    b.run_until(20, "take-off", |b| {
        b.status().mode == FlightMode::Hold && b.height_m() > 2.0
    });
    let status = run(&mut b, "commander status");
    let in_hold = "armed: true\nmode: hold\nlanded: InAir\nfailsafe: none\nterminated: false\nsetpoint owner: none\n";
    assert_eq!(status, in_hold);
    assert_eq!(run(&mut b, "reboot"), "refused: not disarmed\n");
    assert!(run(&mut b, "commander disarm").contains("not landed"));
    assert!(run(&mut b, "commander mode offboard").contains("no setpoints"));
    assert!(run(&mut b, "commander mode orbit").contains("no mode orbit"));
    assert!(b.status().armed);
    assert_eq!(run(&mut b, "commander land"), "done\n");
    b.run_until(30, "landing", |b| !b.status().armed);
    assert_eq!(run(&mut b, "reboot"), "rebooted\n");
}

#[test]
fn a_line_may_come_in_pieces_and_answers_only_who_wants_one() {
    let mut b = Bench::new();
    let respond = SerialControlFlag::SERIAL_CONTROL_FLAG_RESPOND;
    write(&mut b, b"ver", respond);
    write(&mut b, b"\r", respond);
    assert_eq!(answer(&b), format!("Vigil {}\npxh> ", env!("CARGO_PKG_VERSION")));
    b.sent.clear();
    write(&mut b, b"commander arm\n", SerialControlFlag::empty());
    assert_eq!(answer(&b), "");
    assert!(b.status().armed);
}

#[test]
fn what_is_known_is_listed_and_what_is_not_is_said() {
    let mut b = Bench::new();
    assert!(run(&mut b, "help").contains("param set NAME VALUE"));
    assert!(run(&mut b, "ls /etc/extras").contains("parameters.json"));
    assert!(run(&mut b, "ls nowhere").contains("no such file"));
    assert_eq!(run(&mut b, "mission status"), "no mission\n");
    assert!(run(&mut b, "uptime").ends_with(" s\n"));
    assert_eq!(run(&mut b, ""), "");
    assert!(run(&mut b, "rm -rf /").contains("unknown; try help"));
    assert!(run(&mut b, &"x".repeat(5_000)).contains("line too long"));
    assert!(run(&mut b, "param show ********").contains("at most three"));
    b.sent.clear();
    write(&mut b, b"\xFF\xFE\n", SerialControlFlag::SERIAL_CONTROL_FLAG_RESPOND);
    assert!(answer(&b).contains("not text"));
    // An answer of somebody else's shell is no command.
    let reply = SerialControlFlag::SERIAL_CONTROL_FLAG_REPLY | SerialControlFlag::SERIAL_CONTROL_FLAG_RESPOND;
    b.sent.clear();
    write(&mut b, b"commander arm\n", reply);
    assert!(!b.status().armed && answer(&b).is_empty());
}
