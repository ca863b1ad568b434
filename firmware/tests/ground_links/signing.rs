//! Signing keys: the first one, another one, and policies of links.

use super::*;
use vigil_types::files::{Access, replace};

/// A configuration that keeps its state there.
fn with_state(folder: &Path) -> FirmwareConfig {
    let mut config = FirmwareConfig::default();
    config.state.directory = Some(folder.join("state"));
    config.make_state_folder().unwrap();
    config
}

/// The texts in what somebody heard, and whether each packet was signed.
fn texts(far: &Far) -> Vec<(String, bool)> {
    let mut found = Vec::new();
    for bytes in far.raw() {
        for packet in packets(&bytes, &mut FramingCounters::default()) {
            if let Ok(MavMessage::STATUSTEXT(m)) = packet.message() {
                found.push((m.text.to_str().unwrap().to_owned(), packet.is_signed()));
            }
        }
    }
    found
}

#[test]
fn a_first_key_from_setup_signing_is_in_force_at_once_kept_for_the_next_start_and_changed_by_whoever_has_it() {
    const KEY: [u8; 32] = [0xC3; 32];
    let folder = tempfile::tempdir().unwrap();
    let mut config = with_state(folder.path());
    let key_file = folder.path().join("state/firmware0.key");
    let land = command(STATION, ME, MavCmd::MAV_CMD_NAV_LAND);
    let captured = signed(KEY, 0, &land);
    {
        // Who did not ask for it gets no key from the link.
        let mut rig = Rig::new(["", ""], config.gate().unwrap());
        rig.stations[0].say(&setup(ME, KEY));
        assert!(rig.step().is_empty());
        let refusal = [("signing key refused: see --accept-first-key".to_owned(), false)];
        assert_eq!(texts(&rig.stations[0]), refusal);
        assert_eq!(rig.links.statistics().signing.unsigned_key, 1);
    }
    config.signing.accept_first_key = true;
    {
        let mut rig = Rig::new(["", ""], config.gate().unwrap());
        assert!(!key_file.exists(), "nothing is signed yet");
        rig.stations[0].say(&setup(ME, KEY));
        assert!(rig.step().is_empty(), "the flight stack and its log do not see the key");
        for far in [&rig.vehicle, &rig.stations[0], &rig.stations[1]] {
            assert_eq!(texts(far), [("signing key accepted".to_owned(), true)]);
        }
        for (bytes, passes) in [
            (&captured, true),
            (&captured, false),
            (&signed([1; 32], 1, &land), false),
            (&signed(KEY, 120, &land), false),
            (&signed(KEY, 2, &land), true),
        ] {
            rig.stations[1].say(bytes);
            assert_eq!(!rig.step().is_empty(), passes);
        }
        // Now only who has it changes it. A command of before comes again with another key, and then with the same: it
        // stays refused.
        rig.stations[0].say(&setup(ME, [5; 32]));
        rig.step();
        for (present, next) in [(KEY, [5; 32]), ([5; 32], KEY)] {
            rig.stations[0].say(&signed(present, 5, &setup(ME, next)));
            rig.step();
            rig.stations[1].say(&captured);
            assert!(rig.step().is_empty());
        }
        assert_eq!(rig.links.statistics().signing.unsigned_key, 1);
    }
    let mode = |path: &Path| std::fs::metadata(path).unwrap().permissions().mode() & 0o777;
    let state = key_file.parent().unwrap();
    assert_eq!([&*key_file, state].map(mode), [0o600, 0o700]);
    // Whoever could write there could take the key away.
    std::fs::set_permissions(state, std::fs::Permissions::from_mode(0o770)).unwrap();
    let refused = config.make_state_folder().unwrap_err().to_string();
    let at = state.display();
    let expected = format!("state folder {at}: others may write there: `chmod 700 {at}`, as the firmware's user");
    assert_eq!(refused, expected);
    std::fs::set_permissions(state, std::fs::Permissions::from_mode(0o700)).unwrap();
    let mut rig = Rig::new(["", ""], config.gate().unwrap());
    for (bytes, passes) in [(&captured, false), (&signed(KEY, 10, &land), true)] {
        rig.stations[0].say(bytes);
        assert_eq!(!rig.step().is_empty(), passes, "after the restart");
    }
}

/// A configuration whose key is in a file of the user's own.
fn with_key(folder: &Path, key: [u8; 32]) -> (FirmwareConfig, PathBuf) {
    let path = folder.join("vigil.key");
    replace(&path, &key, Access::Private).unwrap();
    let mut config = FirmwareConfig::default();
    config.signing.key_file = Some(path.clone());
    (config, path)
}

#[test]
fn only_a_packet_signed_with_the_present_key_sets_another_and_zeros_are_none() {
    let folder = tempfile::tempdir().unwrap();
    let (config, path) = with_key(folder.path(), [7; 32]);
    {
        // This machine's packets need no signature here; a key does.
        let mut rig = Rig::new(["", ""], config.gate().unwrap());
        rig.stations[0].say(&setup(ME, [1; 32]));
        rig.step();
        let refused = "signing key refused: not signed with present one";
        assert_eq!(texts(&rig.stations[0]), [(refused.to_owned(), true)]);
        rig.stations[0].say(&signed([1; 32], 0, &setup(ME, [1; 32])));
        rig.vehicle.say(&setup(ME, [1; 32]));
        rig.step();
        assert_eq!(texts(&rig.stations[0]), [], "said once in a while");
        rig.stations[0].say(&signed([7; 32], 0, &setup(ME, [0; 32])));
        rig.step();
        let zeros = "signing key refused: all zeros";
        assert_eq!(texts(&rig.stations[0]), [(zeros.to_owned(), true)]);
        assert_eq!(std::fs::read(&path).unwrap(), [7; 32]);
        // Who has the key may set another, which takes the place of the one in the file.
        rig.stations[0].say(&signed([7; 32], 1, &setup(ME, [8; 32])));
        rig.step();
        rig.hush();
        rig.stations[0].say(&signed([8; 32], 2, &heartbeat(STATION)));
        rig.step();
        assert_eq!(rig.vehicle.heard().last(), Some(&(STATION, HEARTBEAT)));
    }
    assert_eq!(std::fs::read_to_string(&path).unwrap(), "08".repeat(32));
}

/// A hundred thousand packets each that are right as MAVLink and made of random bytes, each tenth a SETUP_SIGNING to the
/// guidance computer, unsigned or signed with random keys.
#[test]
fn random_valid_packets_change_no_key() {
    for has_key in [true, false] {
        let folder = tempfile::tempdir().unwrap();
        let (with_key, path) = with_key(folder.path(), [7; 32]);
        let without = with_state(folder.path());
        let config = if has_key { with_key } else { without };
        let mut rig = Rig::new(["", ""], config.gate().unwrap());
        let mut random = Random(0x9E37_79B9_7F4A_7C15);
        for _ in 0..2000 {
            for i in 0..50 {
                let packet = random.packet(i % 10 == 0);
                let from = if i % 2 == 0 { &rig.vehicle } else { &rig.stations[0] };
                from.say(&packet);
            }
            rig.step();
            rig.hush();
        }
        let signing = rig.links.statistics().signing;
        assert!(signing.unsigned_key > 5000, "{signing:?}");
        assert_eq!(signing.signed, 0);
        // The present key, or none, is in force as before.
        rig.own(&[heartbeat(ME)]);
        let heard = rig.stations[1].raw();
        let right = signed([7; 32], 1, &heartbeat(STATION));
        assert!(heard.iter().all(|bytes| (bytes[2] & 1 == 1) == has_key));
        rig.stations[1].say(&right);
        rig.step();
        assert_eq!(rig.links.statistics().signing.signed, u64::from(has_key));
        drop(rig);
        assert_eq!(std::fs::read(&path).unwrap(), [7; 32]);
        assert!(!folder.path().join("state/firmware0.key").exists());
    }
}

#[test]
fn a_signing_key_is_passed_on_to_nobody_and_is_not_in_the_log() {
    let gate = SigningGate::new(None, AllowUnsigned::Loopback).accepting_first_key(true);
    let mut rig = Rig::new(["", ""], gate);
    rig.introduce();
    for target in [VEHICLE, (0, 0), (254, 190)] {
        rig.stations[0].say(&setup(target, [9; 32]));
        // On the vehicle's link, behind something that may pass.
        rig.vehicle.say(&[heartbeat((1, 50)), setup(target, [9; 32])].concat());
        assert_eq!(rig.step(), [(0, ((1, 50), HEARTBEAT))]);
        assert!(rig.vehicle.heard().is_empty());
        assert!(rig.stations[1].heard().iter().all(|(_, id)| *id == HEARTBEAT));
    }
}

#[test]
fn each_link_has_its_own_signing_policy_and_what_was_taken_from_one_is_no_good_on_another() {
    let folder = tempfile::tempdir().unwrap();
    let (config, _) = with_key(folder.path(), [7; 32]);
    let mut rig = Rig::new([",unsigned=never", ""], config.gate().unwrap());
    let land = command(STATION, ME, MavCmd::MAV_CMD_NAV_LAND);
    for station in &rig.stations {
        station.say(&land);
    }
    assert_eq!(
        rig.step(),
        [(2, (STATION, COMMAND_LONG))],
        "the first hears signed packets only"
    );
    let signed = signed([7; 32], 0, &land);
    rig.stations[0].say(&signed);
    assert_eq!(rig.step(), [(1, (STATION, COMMAND_LONG))]);
    rig.stations[1].say(&signed);
    assert!(rig.step().is_empty());
    assert_eq!(rig.links.statistics().signing.replayed, 1);
    // Everything that leaves is signed.
    rig.hush();
    rig.own(&[heartbeat(ME)]);
    assert!(rig.stations[1].raw().iter().all(|bytes| bytes[2] & 1 == 1));
}
