//! Who may speak on a link: MAVLink signing, and the policy on packets without a signature.

mod files;

pub use files::{SigningFileError, read_key};

use crate::links::LinkStatistics;
use crate::throttle::Throttle;
use files::SigningStateWriter;
use std::path::Path;
use std::time::{SystemTime, UNIX_EPOCH};
use vigil_mavlink::framing::{FramingCounters, MAX_PACKET_LEN, packets};
use vigil_mavlink::signing::{
    Refusal, SIGNATURE_LEN, Signing, SigningCounters, SigningKey, SigningMemory, Timestamp, UNITS_PER_SECOND,
    carries_key, timestamp_of_unix_ns,
};
use vigil_types::settings::{FromRow, named_setting};
use vigil_types::{Datagrams, Nanos, ParameterSpec, named};

/// Longest datagram that is read; MAVLink's longest packet is 293 bytes, senders may put several into one datagram.
pub const MAX_DATAGRAM_BYTES: usize = 2048;
/// How often what replay protection needs goes to its file.
const STORE_NS: Nanos = 1_000_000_000;
/// How much later than it is the stored time is while packets still come: more than passes until it is stored again.
const STORE_AHEAD: u64 = 2 * UNITS_PER_SECOND;
/// A SETUP_SIGNING may not set the time further ahead than any packet may be.
const MAX_AHEAD: u64 = 60 * UNITS_PER_SECOND;

named! {
    /// From whom packets without a signature are accepted.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Default, clap::ValueEnum)]
    pub enum AllowUnsigned {
        /// Senders on this machine.
        #[default]
        Loopback => "loopback",
        /// Nobody.
        Never => "never",
        /// Everybody who reaches the link.
        Always => "always",
    }
}

impl AllowUnsigned {
    /// Whether a sender needs no signature. `is_local`: it is on this machine.
    pub fn covers(self, is_local: bool) -> bool {
        match self {
            Self::Loopback => is_local,
            Self::Never => false,
            Self::Always => true,
        }
    }

    /// What people read at start.
    pub fn in_words(self) -> &'static str {
        match self {
            Self::Loopback => "unsigned packets from this machine only",
            Self::Never => "no unsigned packets",
            Self::Always => "unsigned packets from everybody",
        }
    }
}

named_setting!(AllowUnsigned);

impl FromRow for AllowUnsigned {
    fn default_of(_: &ParameterSpec) -> Self {
        Self::default()
    }
}

/// Verifies what a link receives, signs what it sends.
pub struct SigningGate {
    signing: Option<Signing>,
    writer: Option<SigningStateWriter>,
    /// What replay protection knew at the start.
    past: SigningMemory,
    /// What the writer has got last.
    stored: SigningMemory,
    /// While there is no key, SETUP_SIGNING may bring one.
    accepts_first_key: bool,
    allow_unsigned: AllowUnsigned,
    clock: fn() -> Timestamp,
    now: Timestamp,
    stored_ns: Nanos,
    counters: SigningCounters,
    keys_refused: Throttle,
    framing: FramingCounters,
    admitted: Box<[u8; MAX_DATAGRAM_BYTES]>,
    sealed: Box<[u8; MAX_PACKET_LEN + SIGNATURE_LEN]>,
}

impl SigningGate {
    /// Everything passes, nothing is signed.
    pub fn open() -> Self {
        Self::new(None, AllowUnsigned::Always).accepting_first_key(true)
    }

    /// A gate without a file: with `signing` packets are verified and signed. What replay protection knows is lost with it.
    /// Without a key it takes none either, see [`SigningGate::accepting_first_key`].
    pub fn new(signing: Option<Signing>, allow_unsigned: AllowUnsigned) -> Self {
        Self {
            signing,
            writer: None,
            past: SigningMemory::default(),
            stored: SigningMemory::default(),
            accepts_first_key: false,
            allow_unsigned,
            clock: wall_clock,
            now: 0,
            stored_ns: 0,
            counters: SigningCounters::default(),
            keys_refused: Throttle::default(),
            framing: FramingCounters::default(),
            admitted: Box::new([0; MAX_DATAGRAM_BYTES]),
            sealed: Box::new([0; MAX_PACKET_LEN + SIGNATURE_LEN]),
        }
    }

    /// A gate with the key in `key_file`. What replay protection needs over restarts is kept beside it, in
    /// `key_file` + `.NAME.state`: each program that uses the key at the same time needs a `name` of its own.
    ///
    /// # Errors
    /// [`SigningFileError`]: a key that is not one, that others can read, or a state that cannot be kept.
    pub fn with_key_file(key_file: &Path, name: &str, allow_unsigned: AllowUnsigned) -> Result<Self, SigningFileError> {
        Self::with_state(Some(read_key(key_file)?), key_file, name, allow_unsigned)
    }

    /// A gate whose key, if there is one, came by SETUP_SIGNING and was kept in `key_file`: without that file it begins
    /// without a key. What comes later is kept there too.
    ///
    /// # Errors
    /// [`SigningFileError`]: a file that is not a key or that others can read, or a state that cannot be kept.
    pub fn with_kept_key(key_file: &Path, name: &str, allow_unsigned: AllowUnsigned) -> Result<Self, SigningFileError> {
        let is_there = !matches!(key_file.try_exists(), Ok(false));
        let key = is_there.then(|| read_key(key_file)).transpose()?;
        Self::with_state(key, key_file, name, allow_unsigned)
    }

    fn with_state(
        key: Option<SigningKey>,
        key_file: &Path,
        name: &str,
        allow_unsigned: AllowUnsigned,
    ) -> Result<Self, SigningFileError> {
        let (writer, past, stored) = SigningStateWriter::start(key_file, name, (wall_clock(), STORE_AHEAD))?;
        let signing = key.map(|key| Signing::new(key, 0, past.clone()));
        let mut gate = Self::new(signing, allow_unsigned);
        (gate.writer, gate.past, gate.stored) = (Some(writer), past, stored);
        Ok(gate)
    }

    /// Whether a SETUP_SIGNING passes while there is no key, from whoever may speak without a signature. With a key only one
    /// that is signed with it does.
    pub fn accepting_first_key(mut self, accepts: bool) -> Self {
        self.accepts_first_key = accepts;
        self
    }

    /// Takes the signatures' time from `clock` instead of the machine's: for tests.
    pub fn with_clock(mut self, clock: fn() -> Timestamp) -> Self {
        self.clock = clock;
        self
    }

    /// Whether packets are signed and verified.
    pub fn has_key(&self) -> bool {
        self.signing.is_some()
    }

    /// From whom packets without a signature are accepted.
    pub fn allow_unsigned(&self) -> AllowUnsigned {
        self.allow_unsigned
    }

    /// What was accepted and refused.
    pub fn counters(&self) -> SigningCounters {
        self.counters
    }

    /// Statistics of a wire with what the gate found in its datagrams, unless it finds the packets itself, and signing's.
    pub(crate) fn statistics(&self, (wire, is_stream): (LinkStatistics, bool)) -> LinkStatistics {
        LinkStatistics {
            framing: if is_stream { wire.framing } else { self.framing },
            signing: self.counters,
            ..wire
        }
    }

    /// Before anything is received in a step: looks at the clock, and has the state stored once a second, and as soon as packets were
    /// accepted that it does not cover.
    pub fn begin(&mut self, now_ns: Nanos) {
        self.now = if self.has_key() { (self.clock)() } else { 0 };
        if let (Some(signing), Some(writer)) = (&self.signing, &mut self.writer)
            && (now_ns.saturating_sub(self.stored_ns) >= STORE_NS || signing.has_overtaken(&self.stored))
        {
            self.stored_ns = now_ns;
            let memory = signing.memory().clone();
            self.stored = memory.ahead(&self.past, self.now, STORE_AHEAD);
            writer.offer(self.stored.clone());
        }
    }

    /// From now on signs and verifies with `key`, as a SETUP_SIGNING asks that passed the gate. Timestamps go on from
    /// `newest` (of the message) or what they were, whichever is later, but never from more than a minute ahead. A key that
    /// came from a file is replaced there too. A key of zeros changes nothing: the answer is `false`.
    pub fn set_key(&mut self, key: SigningKey, newest: Timestamp) -> bool {
        if key.is_zero() {
            return false;
        }
        // The streams' times stay: the same key again must not make good what was accepted before.
        let mut memory = self.signing.as_ref().map_or(&self.past, Signing::memory).clone();
        // What goes out in this step is signed with it already.
        self.now = (self.clock)();
        memory.newest = memory.newest.max(newest.min(self.now + MAX_AHEAD));
        if let Some(writer) = &mut self.writer {
            self.stored = memory.clone().ahead(&self.past, self.now, STORE_AHEAD);
            writer.replace_key(key, self.stored.clone());
        }
        self.signing = Some(Signing::new(key, 0, memory));
        true
    }

    /// What to tell everybody of keys that were refused since the last call, at most every ten seconds.
    pub fn refused_key(&mut self, now_ns: Nanos) -> Option<&'static str> {
        let refused = self.counters.unsigned_key;
        let text = match self.has_key() {
            true => "signing key refused: not signed with present one",
            false => "signing key refused: see --accept-first-key",
        };
        self.keys_refused.is_due(now_ns, refused).then_some(text)
    }

    /// Appends to `received` what may pass of a datagram by the policy of its link; refused packets are left out and counted. Returns whether
    /// anything passed. `is_local`: the sender is on this machine. Several links share the gate, and not only the key, so that a
    /// packet taken from one link cannot be replayed on another.
    pub fn admit_by(
        &mut self,
        allow_unsigned: AllowUnsigned,
        is_local: bool,
        link: u8,
        datagram: &[u8],
        received: &mut Datagrams,
    ) -> bool {
        let allow_unsigned = allow_unsigned.covers(is_local);
        if allow_unsigned && self.signing.is_none() && (self.accepts_first_key || !holds_key(datagram)) {
            // It passes as it is, damage included.
            return received.push(link, datagram);
        }
        let mut len = 0;
        for packet in packets(datagram, &mut self.framing) {
            let verdict = match &mut self.signing {
                Some(signing) => signing.verify(self.now, &packet, allow_unsigned),
                None if carries_key(&packet) && !(allow_unsigned && self.accepts_first_key) => {
                    Err(Refusal::UnsignedKey)
                }
                None if allow_unsigned => Ok(()),
                // Without a key no signature can be right.
                None if packet.is_signed() => Err(Refusal::WrongSignature),
                None => Err(Refusal::Unsigned),
            };
            self.counters.count(packet.is_signed(), verdict);
            // The packets of a datagram are together no longer than it.
            if verdict.is_ok()
                && let Some(slot) = self.admitted.get_mut(len..len + packet.raw().len())
            {
                slot.copy_from_slice(packet.raw());
                len += packet.raw().len();
            }
        }
        match self.admitted.get(..len) {
            Some(admitted) if len > 0 => received.push(link, admitted),
            _ => false,
        }
    }

    /// The packet as it is to be sent: signed if there is a key.
    pub fn seal<'a>(&'a mut self, packet: &'a [u8]) -> &'a [u8] {
        let Some(signing) = &mut self.signing else {
            return packet;
        };
        match signing.sign(self.now, packet, self.sealed.as_mut_slice()) {
            Ok(len) => self.sealed.get(..len).unwrap_or(packet),
            // Not a packet of the flight stack's, which are all MAVLink 2.
            Err(_) => packet,
        }
    }
}

impl Drop for SigningGate {
    fn drop(&mut self) {
        if let (Some(signing), Some(writer)) = (&self.signing, &mut self.writer) {
            // Exact, now that nothing more is accepted.
            writer.offer(signing.memory().clone());
        }
    }
}

/// Whether a datagram brings a signing key.
fn holds_key(datagram: &[u8]) -> bool {
    packets(datagram, &mut FramingCounters::default()).any(|packet| carries_key(&packet))
}

fn wall_clock() -> Timestamp {
    let since_1970 = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    // Nanoseconds since 1970 fit until the year 2554.
    timestamp_of_unix_ns(since_1970.as_nanos() as u64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use vigil_mavlink::common::{HEARTBEAT_DATA, MavMessage};
    use vigil_mavlink::framing::encode;

    const NOW: Timestamp = 40_000_000_000_000;

    fn heartbeat(sequence: u8) -> Vec<u8> {
        encode((1, 1), sequence, &MavMessage::HEARTBEAT(HEARTBEAT_DATA::DEFAULT))
    }

    fn signing() -> Signing {
        Signing::new(SigningKey([7; 32]), 0, SigningMemory::default())
    }

    fn gate(signing: Option<Signing>, allow_unsigned: AllowUnsigned) -> SigningGate {
        let mut gate = SigningGate::new(signing, allow_unsigned).with_clock(|| NOW);
        gate.begin(0);
        gate
    }

    #[test]
    fn a_stream_that_nothing_stored_covers_is_stored_at_once() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        let key = folder.path().join("vigil.key");
        std::fs::write(&key, [7; 32]).unwrap();
        std::fs::set_permissions(&key, PermissionsExt::from_mode(0o600)).unwrap();
        let gate = SigningGate::with_key_file(&key, "3", AllowUnsigned::Never).unwrap();
        let mut killed = gate.with_clock(|| NOW);
        killed.begin(0);
        assert_eq!(admitted(&mut killed, true, &signed(0)).len(), 1);
        killed.begin(1);
        std::mem::forget(killed);
        let begun = std::time::Instant::now();
        let stored = || std::fs::read_to_string(folder.path().join("vigil.key.3.state")).unwrap();
        while !stored().contains(&(NOW + STORE_AHEAD).to_string()) {
            assert!(begun.elapsed().as_secs() < 20, "{}", stored());
            std::thread::yield_now();
        }
    }

    fn signed(sequence: u8) -> Vec<u8> {
        let mut sender = gate(Some(signing()), AllowUnsigned::Never);
        for _ in 0..sequence {
            sender.seal(&heartbeat(0));
        }
        sender.seal(&heartbeat(sequence)).to_vec()
    }

    fn admitted(gate: &mut SigningGate, is_local: bool, datagram: &[u8]) -> Vec<Vec<u8>> {
        let mut received = Datagrams::default();
        let passed = gate.admit_by(gate.allow_unsigned, is_local, 0, datagram, &mut received);
        assert_eq!(passed, !received.is_empty());
        received.iter().map(|(_, bytes)| bytes.to_vec()).collect()
    }

    #[test]
    fn the_default_hears_unsigned_packets_of_this_machine_only() {
        let mut default = gate(None, AllowUnsigned::default());
        assert_eq!(admitted(&mut default, true, &heartbeat(0)), [heartbeat(0)]);
        assert!(admitted(&mut default, false, &heartbeat(0)).is_empty());
        assert!(admitted(&mut default, false, &signed(0)).is_empty());
        let counters = default.counters();
        assert_eq!((counters.unsigned, counters.wrong_signature), (1, 1));
        let mut with_key = gate(Some(signing()), AllowUnsigned::default());
        admitted(&mut with_key, true, &heartbeat(0));
        let counters = with_key.counters();
        assert_eq!((counters.unsigned_allowed, counters.refused()), (1, 0));
    }

    #[test]
    fn who_may_speak_unsigned_depends_on_policy_and_sender() {
        for (policy, is_local, passes) in [
            (AllowUnsigned::Loopback, true, true),
            (AllowUnsigned::Loopback, false, false),
            (AllowUnsigned::Never, true, false),
            (AllowUnsigned::Never, false, false),
            (AllowUnsigned::Always, true, true),
            (AllowUnsigned::Always, false, true),
        ] {
            for key in [None, Some(signing())] {
                let got = admitted(&mut gate(key, policy), is_local, &heartbeat(0));
                assert_eq!(!got.is_empty(), passes, "{policy:?} {is_local}");
            }
            let got = admitted(&mut gate(Some(signing()), policy), is_local, &signed(0));
            assert_eq!(got, [signed(0)], "who has the key is heard everywhere");
        }
    }

    #[test]
    fn a_new_key_takes_the_place_of_the_old_one_and_its_time_is_not_in_the_far_future() {
        let mut gate = gate(Some(signing()), AllowUnsigned::Never);
        gate.set_key(SigningKey([9; 32]), NOW * 2);
        assert!(
            admitted(&mut gate, true, &signed(0)).is_empty(),
            "signed with the old key"
        );
        let sealed = gate.seal(&heartbeat(0)).to_vec();
        let stamp = sealed.len() - SIGNATURE_LEN + 1;
        let mut timestamp = [0; 8];
        timestamp[..6].copy_from_slice(&sealed[stamp..stamp + 6]);
        assert_eq!(u64::from_le_bytes(timestamp), NOW + MAX_AHEAD + 1);
    }

    #[test]
    fn of_a_datagram_only_what_may_pass_does() {
        let mut gate = gate(Some(signing()), AllowUnsigned::Never);
        let mixed = [heartbeat(9), signed(0), b"garbage".to_vec(), signed(1), signed(0)].concat();
        assert_eq!(admitted(&mut gate, true, &mixed), [[signed(0), signed(1)].concat()]);
        let counters = gate.counters();
        assert_eq!((counters.signed, counters.unsigned, counters.replayed), (2, 1, 1));
        assert_eq!(gate.framing.garbage_bytes, 7);
    }

    #[test]
    fn an_open_gate_changes_nothing() {
        let mut gate = gate(None, AllowUnsigned::Always);
        assert_eq!(admitted(&mut gate, false, b"no packet"), [b"no packet"]);
        assert_eq!(gate.seal(b"no packet"), b"no packet");
    }
}
