//! A file that is cut, altered, of another kind or of another version: an error or a note, never a panic, never a
//! wrong record.

mod common;

use common::{Draw, bits, drawn, lockstep};
use mcap::records::{Metadata, Record};
use proptest::prelude::*;
use std::path::Path;
use vigil_log::{LOG_FORMAT, LogEnd, LogPlace, ReadError, Reader, Recorder, RecoverError, TickRecord, recover};

const STEPS: u64 = 6;

/// A small closed log. Steps lie 0.4 s apart, so that it has several chunks.
fn small_log() -> Vec<u8> {
    log_of(small)
}

fn log_of(fill: impl Fn(u64, &mut TickRecord)) -> Vec<u8> {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("good.mcap");
    let mut recorder = Recorder::start(lockstep(LogPlace::File(path.clone()))).unwrap();
    for step in 0..STEPS {
        assert!(recorder.record(|slot| fill(step, slot)));
    }
    assert_eq!(recorder.finish().failure, None);
    std::fs::read(path).unwrap()
}

fn small(step: u64, record: &mut TickRecord) {
    Draw(step).record(step, step * 400_000_000, record);
    // One frame is enough, and keeps the file small.
    if step != 1 {
        record.set_frame(None);
    }
}

fn expected(step: u64) -> Vec<u64> {
    let mut record = Box::default();
    small(step, &mut record);
    bits(&record)
}

/// Reads all that can be read; every record must be the true one. Returns their number and how it ended.
fn read_all(path: &Path) -> Result<(u64, Option<LogEnd>), ReadError> {
    let mut reader = Reader::open(path)?;
    let mut records = 0;
    for record in reader.by_ref() {
        let record = record?;
        assert!(bits(&record) == expected(records), "record {records} is wrong");
        records += 1;
    }
    Ok((records, reader.end()))
}

#[test]
fn a_log_cut_anywhere_gives_its_complete_part_and_says_so() {
    assert!(drawn(1).frame().is_some(), "the step that is to have a frame has one");
    let dir = tempfile::tempdir().unwrap();
    let good = small_log();
    let path = dir.path().join("cut.mcap");
    // What counts the records is the last metadata; behind it stands only the index.
    let (begin, length) = *pieces(&good, &[12]).last().unwrap();
    let mut last = 0;
    let mut counts = Vec::new();
    for cut in (0..good.len()).step_by(good.len() / 150) {
        std::fs::write(&path, &good[..cut]).unwrap();
        match read_all(&path) {
            Ok((records, end)) => {
                let whole = cut >= begin + length;
                let expected = match whole {
                    true => LogEnd::Closed { dropped: 0 },
                    false => LogEnd::Interrupted { records },
                };
                assert_eq!(end, Some(expected), "cut at {cut}");
                assert!(!whole || records == STEPS, "cut at {cut}");
                assert!(records >= last, "a longer part gives no fewer records");
                last = records;
                counts.push(records);
            }
            // Only where not even the metadata is whole.
            Err(error) => {
                assert!(cut < 1000 && counts.is_empty(), "cut at {cut}: {error}");
                assert!(matches!(error, ReadError::Empty { .. }), "cut at {cut}: {error}");
            }
        }
    }
    counts.dedup();
    assert!(counts.len() >= 3 && last == STEPS, "several chunks: {counts:?}");
}

#[test]
fn a_log_that_was_not_closed_is_recovered_into_a_new_file_with_an_index() {
    let dir = tempfile::tempdir().unwrap();
    let good = small_log();
    let (cut, closed) = (dir.path().join("cut.mcap"), dir.path().join("closed.mcap"));
    // Within the last chunk: what counts the records comes after it.
    let (begin, length) = *pieces(&good, &[CHUNK]).last().unwrap();
    std::fs::write(&cut, &good[..begin + length / 2]).unwrap();
    assert!(mcap::Summary::read(&std::fs::read(&cut).unwrap()).is_err());
    let (records, _) = read_all(&cut).unwrap();
    assert!(records > 2);

    let recovery = recover(&cut, &closed).unwrap();
    assert_eq!(
        (recovery.records, recovery.end),
        (records, LogEnd::Interrupted { records })
    );
    let text = recovery.to_string();
    assert!(text.contains("not closed") && !text.contains("damage"), "{text}");
    assert_eq!(read_all(&closed).unwrap().0, records);
    let index = mcap::Summary::read(&std::fs::read(&closed).unwrap()).unwrap().unwrap();
    let tick = index.channels.values().find(|c| c.topic == "/vigil/tick").unwrap();
    assert_eq!(index.stats.unwrap().channel_message_counts[&tick.id], records);

    // What is there is never overwritten.
    assert!(matches!(recover(&cut, &closed), Err(RecoverError::Exists { .. })));
    // Where nothing can be written, what the system said is passed on, and nothing else.
    let nowhere = recover(&cut, &dir.path().join("none").join("x.mcap"))
        .unwrap_err()
        .to_string();
    assert!(
        nowhere.ends_with("x.mcap cannot be written: No such file or directory (os error 2)"),
        "{nowhere}"
    );
}

/// The chunks of a log that are not packed, packed by Zstandard; the index behind them is of no more use.
fn packed_by_zstandard(log: &[u8]) -> Vec<u8> {
    let (mut packed, mut from) = (Vec::new(), 0);
    for (begin, length) in pieces(log, &[CHUNK]) {
        // Behind opcode and length: times, size and checksum, no name, the stored size.
        let head = &log[begin + 9..][..28];
        let content = &log[begin + 9 + 28 + 4 + 8..begin + length];
        let smaller = ruzstd::encoding::compress_to_vec(content, ruzstd::encoding::CompressionLevel::Fastest);
        packed.extend(&log[from..begin]);
        let stored_len = smaller.len() as u64;
        packed.push(6);
        packed.extend((28 + 8 + 8 + stored_len).to_le_bytes());
        packed.extend([head, &4u32.to_le_bytes(), b"zstd", &stored_len.to_le_bytes()].concat());
        packed.extend(smaller);
        from = begin + length;
    }
    packed.extend(&log[from..]);
    packed
}

/// The same log as another program writes it anew: chunks packed otherwise or none, the metadata in front or behind.
fn rewritten(log: &[u8], form: &str, options: mcap::WriteOptions, metadata_behind: bool) -> Vec<u8> {
    let mut writer = options.create(std::io::Cursor::new(Vec::new())).unwrap();
    let mut behind = Vec::new();
    for record in mcap::read::ChunkFlattener::new(log).unwrap() {
        match record.unwrap() {
            Record::Metadata(metadata) if metadata_behind => behind.push(metadata),
            Record::Metadata(metadata) => writer.write_metadata(&metadata).unwrap(),
            Record::Schema { header, data } => {
                let _ = writer.add_schema_with_id(header.id, &header.name, &header.encoding, &data);
            }
            Record::Channel(c) => {
                let (topic, encoding) = (&c.topic, &c.message_encoding);
                let _ = writer.add_channel_with_id(c.id, c.schema_id, topic, encoding, &c.metadata);
            }
            Record::Message { header, data } => writer.write_to_known_channel(&header, &data).unwrap(),
            // The summary repeats what stands before; the writer makes its own.
            Record::DataEnd(_) => break,
            _ => {}
        }
    }
    for metadata in behind {
        writer.write_metadata(&metadata).unwrap();
    }
    writer.finish().unwrap();
    let log = writer.into_inner().into_inner();
    if form == "zstd" { packed_by_zstandard(&log) } else { log }
}

/// Each way in which MCAP can hold a log, by name.
fn forms(chunk_size: u64) -> Vec<(&'static str, mcap::WriteOptions)> {
    let packed = |compression| {
        mcap::WriteOptions::new()
            .compression(compression)
            .chunk_size(Some(chunk_size))
    };
    vec![
        ("lz4", packed(Some(mcap::Compression::Lz4))),
        ("zstd", packed(None)),
        ("chunks that are not packed", packed(None)),
        ("no chunks", mcap::WriteOptions::new().use_chunks(false)),
    ]
}

#[test]
fn a_log_that_another_program_wrote_anew_is_read_and_recovered_in_every_form_of_the_format() {
    let dir = tempfile::tempdir().unwrap();
    let good = small_log();
    // A chunk for each message.
    for (name, options) in forms(1) {
        for metadata_behind in [false, true] {
            let log = rewritten(&good, name, options.clone(), metadata_behind);
            let path = dir.path().join("anew.mcap");
            std::fs::write(&path, &log).unwrap();
            let read = read_all(&path).unwrap_or_else(|error| panic!("{name}: {error}"));
            assert_eq!(
                read,
                (STEPS, Some(LogEnd::Closed { dropped: 0 })),
                "{name}, {metadata_behind}"
            );
            let (steps, recovery) = recovered(&log);
            assert_eq!(
                (steps, recovery.lost),
                ((0..STEPS).collect(), 0),
                "{name}, {metadata_behind}"
            );
        }
        // Cut in the middle, and with a length that leads nowhere: what is whole is recovered, before it and behind it.
        let log = rewritten(&good, name, options, false);
        let path = dir.path().join("cut.mcap");
        std::fs::write(&path, &log[..log.len() * 2 / 3]).unwrap();
        let (records, end) = read_all(&path).unwrap_or_else(|error| panic!("{name}: {error}"));
        assert_eq!(end, Some(LogEnd::Interrupted { records }), "{name}");
        if records > 0 {
            let (steps, _) = recovered(&log[..log.len() * 2 / 3]);
            assert_eq!(steps.len() as u64, records, "{name}");
        }
        let pieces = pieces(&log, &[5, 6]);
        let (begin, _) = pieces[pieces.len() / 2];
        let mut bad = log.clone();
        bad[begin + 8] = 0x77;
        std::fs::write(&path, &bad).unwrap();
        let before = Reader::open(&path).unwrap().filter(Result::is_ok).count();
        let (steps, recovery) = recovered(&bad);
        assert!(before < steps.len(), "{name}: {before}, {steps:?}");
        assert_eq!(recovery.lost, STEPS - steps.len() as u64, "{name}");
    }
}

#[test]
fn a_compression_that_nobody_knows_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let mut log = small_log();
    for (begin, _) in pieces(&log, &[CHUNK]) {
        log[begin + 9 + 28 + 4..][..3].copy_from_slice(b"br9");
    }
    let (path, copy) = (dir.path().join("br9.mcap"), dir.path().join("copy.mcap"));
    std::fs::write(&path, &log).unwrap();
    for error in [
        read_all(&path).unwrap_err().to_string(),
        recover(&path, &copy).unwrap_err().to_string(),
    ] {
        assert!(
            error.contains("br9.mcap") && error.contains("compressed with `br9`"),
            "{error}"
        );
        assert!(error.contains("lz4, zstd and nothing are what can be read"), "{error}");
    }
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1, "no half of a copy");
}

/// The same log with some of its chunks, which are not packed, taken apart: their messages lie outside of any.
fn taken_apart(log: &[u8], every: usize) -> Vec<u8> {
    let (mut apart, mut from) = (Vec::new(), 0);
    for (begin, _) in pieces(log, &[CHUNK]).into_iter().step_by(every) {
        apart.extend(&log[from..begin]);
        // Opcode and length; times, size and checksum, no name, the stored size.
        from = begin + 9 + 28 + 4 + 8;
    }
    apart.extend(&log[from..]);
    apart
}

#[test]
fn messages_outside_of_chunks_are_recovered_from_a_file_that_has_chunks_as_well() {
    let good = small_log();
    let chunked = rewritten(&good, "", forms(1)[2].1.clone(), false);
    // Among the chunks, and in a log without any to which somebody attached another log.
    let mut attached = taken_apart(&chunked, 1);
    let other = [&[0; 24][..], &(good.len() as u64).to_le_bytes(), &good, &[0; 4]].concat();
    let other = [&[9][..], &(other.len() as u64).to_le_bytes(), &other].concat();
    let (metadata, length) = pieces(&attached, &[METADATA])[0];
    attached.splice(metadata + length..metadata + length, other);
    for log in [taken_apart(&chunked, 2), taken_apart(&chunked, 3), attached] {
        let (steps, recovery) = recovered(&log);
        assert_eq!((steps, recovery.lost), ((0..STEPS).collect(), 0));
        // A chunk's index whose opcode was damaged is no message.
        for (index, _) in pieces(&log, &[MESSAGE_INDEX]) {
            let mut bad = log.clone();
            bad[index] = 5;
            assert_eq!(recovered(&bad).0, (0..STEPS).collect::<Vec<_>>(), "{index}");
        }
    }
}

/// A log that is broken in one way of many, how, and where the broken piece begins.
fn broken(good: &[u8]) -> Vec<(String, usize, Vec<u8>)> {
    let mut all = Vec::new();
    for (form, options) in forms(8_000).into_iter().take(3) {
        let log = rewritten(good, form, options, false);
        let chunks = pieces(&log, &[CHUNK]);
        for (number, (begin, length)) in chunks.iter().enumerate().skip(1) {
            let name_len = usize::from(log[begin + 9 + 28]);
            for (what, at, flip) in [
                ("a bit in the middle of the content", begin + length / 2, 0x10),
                ("the first byte of the content", begin + 9 + 28 + 4 + name_len + 8, 0xff),
                ("a bit near the end of the content", begin + length * 7 / 8, 0x01),
                ("the unpacked size", begin + 9 + 16, 0x7f),
                ("the unpacked size, beyond all memory", begin + 9 + 16 + 6, 0x7f),
                ("the checksum", begin + 9 + 24, 0x01),
                ("the stored size", begin + 9 + 28 + 4 + name_len, 0x05),
                ("the length", begin + 1, 0x40),
                ("the opcode", *begin, 0x42),
            ] {
                // A reader passes over a piece of a kind that it does not know: without the frame's chunks only the count is wrong.
                if what == "the opcode" && number > 2 {
                    continue;
                }
                let mut bad = log.clone();
                bad[at] ^= flip;
                all.push((format!("{form}: {what} of chunk {number}"), *begin, bad));
            }
        }
    }
    all
}

#[test]
fn damage_is_reported_by_record_place_and_remedy_and_never_as_a_librarys_bare_error() {
    let dir = tempfile::tempdir().unwrap();
    let good = small_log();
    let (mut noticed, mut silent) = (0, Vec::new());
    for (name, begin, bytes) in broken(&good) {
        let path = dir.path().join("bad.mcap");
        std::fs::write(&path, &bytes).unwrap();
        let (steps, recovery) = recovered(&bytes);
        let (lost, text) = (STEPS - steps.len() as u64, recovery.to_string());
        assert!(
            !name.contains("content") || (1..STEPS).contains(&lost),
            "{name}: {steps:?}"
        );
        match recovery.end {
            LogEnd::Closed { .. } => {
                assert_eq!(recovery.lost, lost, "{name}");
                let said = text.contains("lost to damage") && text.contains("records,");
                assert_eq!(said, lost > 0, "{name}: {text}");
            }
            // Behind the last chunk nothing says where the count of records begins.
            end => assert!(
                !name.contains("content") && text.contains("not closed"),
                "{name}: {end:?}, {text}"
            ),
        }
        match read_all(&path) {
            Err(error) => {
                let error = error.to_string();
                for words in [
                    "bad.mcap is damaged after record ",
                    " s into the log",
                    ", at byte ",
                    "`vigil recover` saves",
                ] {
                    assert!(error.contains(words), "{name}: {error}");
                }
                let place = format!(", at byte {begin}: ");
                assert!(error.contains(&place), "{name}: {begin}, {error}");
                for bare in ["LZ4 error", "I/O error", "Unknown frame descriptor", "ERROR_"] {
                    assert!(!error.contains(bare), "{name}: {error}");
                }
                // What is read before the damage is what the copy begins with.
                let before = Reader::open(&path).unwrap().filter(Result::is_ok).count() as u64;
                assert!(before <= recovery.records, "{name}");
                noticed += 1;
            }
            // A length that leads beyond the end reads as a log that was cut; one beside which the checksum holds costs nothing.
            Ok((records, end)) => {
                let cut = Some(LogEnd::Interrupted { records });
                assert!(
                    end == cut || (records, recovery.records) == (STEPS, STEPS),
                    "{name}: {records}, {end:?}"
                );
                assert!(records <= recovery.records, "{name}: {records}, {recovery}");
                silent.push(name);
            }
        }
    }
    assert!(
        noticed >= 40 && silent.len() <= noticed / 3,
        "{noticed} noticed, not damaged for a reader: {silent:?}"
    );
}

/// Opcodes.
const MESSAGE: u8 = 5;
const CHUNK: u8 = 6;
const MESSAGE_INDEX: u8 = 7;
const METADATA: u8 = 12;

/// Where the records of these kinds begin in a log, and how long each is.
fn pieces(log: &[u8], opcodes: &[u8]) -> Vec<(usize, usize)> {
    let mut at = 8;
    let mut chunks = Vec::new();
    while let Some(head) = log.get(at..at + 9) {
        let length = 9 + u64::from_le_bytes(head[1..].try_into().unwrap()) as usize;
        if head[0] == 15 {
            break;
        }
        if opcodes.contains(&head[0]) {
            chunks.push((at, length));
        }
        at += length;
    }
    chunks
}

/// Recovers a log, reads the copy back and checks that every record is the true one; returns their steps.
fn recovered(bytes: &[u8]) -> (Vec<u64>, vigil_log::Recovery) {
    let dir = tempfile::tempdir().unwrap();
    let (damaged, copy) = (dir.path().join("damaged.mcap"), dir.path().join("copy.mcap"));
    std::fs::write(&damaged, bytes).unwrap();
    let recovery = recover(&damaged, &copy).unwrap();
    let mut reader = Reader::open(&copy).unwrap();
    let mut steps = Vec::new();
    for record in reader.by_ref() {
        let mut record = record.unwrap();
        let step = record.timing.step;
        // The records behind a gap say how many are missing.
        assert_eq!(record.dropped_before, step - steps.len() as u64);
        record.dropped_before = 0;
        assert!(bits(&record) == expected(step), "step {step} is wrong");
        steps.push(step);
    }
    let dropped = recovery.lost;
    match recovery.end {
        LogEnd::Closed { .. } => assert_eq!(reader.end(), Some(LogEnd::Closed { dropped })),
        end => assert_eq!(reader.end(), Some(end)),
    }
    (steps, recovery)
}

#[test]
fn what_is_whole_around_damage_is_recovered_and_what_is_lost_is_reported() {
    let good = small_log();
    let chunks = pieces(&good, &[CHUNK]);
    assert!(chunks.len() >= 3, "several chunks: {chunks:?}");
    let all: Vec<u64> = (0..STEPS).collect();
    let (steps, whole) = recovered(&good);
    assert_eq!((steps, whole.gaps.len(), whole.lost), (all.clone(), 0, 0));
    // One byte of the mark, of what stands before the first chunk, of an index, of what the summary says again: no record is lost.
    let ((metadata, _), (index, _)) = (pieces(&good, &[METADATA])[0], pieces(&good, &[MESSAGE_INDEX])[1]);
    let topic = good.windows(11).rposition(|bytes| bytes == b"/vigil/tick").unwrap();
    for at in [0, 1, 3]
        .map(|byte| {
            [
                byte,
                8 + byte,
                metadata + byte,
                index + byte,
                topic + 1 + byte,
                topic - 8 + byte,
            ]
        })
        .concat()
    {
        for flip in [0x02, 0x03, 0x10, 0x40] {
            let mut bad = good.clone();
            bad[at] ^= flip;
            assert_eq!(recovered(&bad).0, all, "{at}, {flip}");
        }
    }
    // Where the metadata itself is, nothing says what it was: that is said, and no remedy that there is not.
    let (dir, mut bad) = (tempfile::tempdir().unwrap(), good.clone());
    bad[metadata + 9] ^= 1;
    std::fs::write(dir.path().join("bad.mcap"), &bad).unwrap();
    let error = recover(&dir.path().join("bad.mcap"), &dir.path().join("copy.mcap"))
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("says which version of Vigil wrote it") && !error.contains("vigil recover"),
        "{error}"
    );
}

#[test]
fn a_step_that_is_there_twice_is_recovered_once_and_one_later_than_any_loop_runs_is_left_out() {
    let mut twice = rewritten(&small_log(), "", forms(1)[3].1.clone(), false);
    for (begin, length) in pieces(&twice, &[MESSAGE]).into_iter().rev() {
        let again = twice[begin..begin + length].to_vec();
        twice.splice(begin + length..begin + length, again);
    }
    let (steps, recovery) = recovered(&twice);
    assert_eq!((steps, recovery.lost), ((0..STEPS).collect(), 0));

    let late = log_of(|step, record| {
        small(step, record);
        record.now_ns = if step == 3 { u64::MAX } else { record.now_ns };
    });
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("late.mcap");
    std::fs::write(&path, &late).unwrap();
    let error = read_all(&path).unwrap_err().to_string();
    let said = "step 3 has the time 18446744073709551615 ns, later than any loop runs";
    assert!(error.contains("after record 3") && error.contains(said), "{error}");
    assert_eq!(recovered(&late).0, [0, 1, 2, 4, 5]);
}

#[test]
fn a_log_within_another_file_is_not_that_file() {
    let (dir, good) = (tempfile::tempdir().unwrap(), small_log());
    let (path, copy) = (dir.path().join("two.mcap"), dir.path().join("copy.mcap"));
    // In a zip file without packing, in a tar of two, and far behind something else.
    for front in [&b"PK\x03\x04 and what follows"[..], &[0; 512], &[7; 100_000]] {
        std::fs::write(&path, [front, &good, &good].concat()).unwrap();
        let error = recover(&path, &copy).unwrap_err();
        assert!(matches!(error, RecoverError::Read(ReadError::NotMcap(..))), "{error}");
        assert!(!copy.exists());
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 150, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn an_altered_log_never_gives_a_wrong_record(edits in prop::collection::vec((any::<prop::sample::Index>(), 1_u8..), 1..4)) {
        thread_local! {
            static GOOD: (tempfile::TempDir, Vec<u8>) = (tempfile::tempdir().unwrap(), small_log());
        }
        GOOD.with(|(dir, good)| {
            let mut bad = good.clone();
            for (index, flip) in &edits {
                let at = index.index(bad.len());
                bad[at] ^= flip;
            }
            let path = dir.path().join("altered.mcap");
            std::fs::write(&path, &bad).unwrap();
            // Ok where the bytes do not matter to a replay (the viewers' index, the library's name), else an error.
            let _ = read_all(&path);
        });
    }
}

/// An MCAP file with one metadata record, its entries as `key=value`.
fn with_metadata(path: &Path, name: &str, entries: &str) {
    let mut writer = mcap::Writer::new(std::fs::File::create(path).unwrap()).unwrap();
    let entries = entries
        .split_terminator(',')
        .map(|entry| entry.split_once('=').unwrap());
    let metadata = Metadata {
        name: name.to_owned(),
        metadata: entries.map(|(key, value)| (key.to_owned(), value.to_owned())).collect(),
    };
    writer.write_metadata(&metadata).unwrap();
    writer.finish().unwrap();
}

#[test]
fn a_wrong_file_is_named_for_what_it_is() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("file.mcap");
    let error = |path: &Path| Reader::open(path).err().unwrap();

    assert!(matches!(error(&path), ReadError::Io(_)));
    std::fs::write(&path, "").unwrap();
    assert!(matches!(error(&path), ReadError::Empty { .. }));
    std::fs::write(&path, "[pilot]\nkind = 'geometric' and a long text\n").unwrap();
    assert!(matches!(error(&path), ReadError::NotMcap { .. }));
    for (first, kind) in [
        (&b"ULog\x01\x12\x35\x01 and what follows"[..], "a ULog of PX4"),
        (b"#ROSBAG V2.0\n and what follows", "a ROS 1 bag"),
        (b"SQLite format 3\0 and what follows", "ROS 2 records bags"),
        (b"\x1f\x8b\x08\0 and what follows, packed", "a gzip file: unpack it"),
        (b"\xa3\x95\x80\x80 and what follows", "a DataFlash log"),
        (
            b"version https://git-lfs.github.com/spec/v1\noid",
            "a pointer of Git LFS",
        ),
    ] {
        std::fs::write(&path, first).unwrap();
        let text = error(&path).to_string();
        assert!(
            text.contains(kind) && text.contains("give the .mcap file of a flight"),
            "{text}"
        );
    }
    assert!(matches!(error(dir.path()), ReadError::Io(_)));
    with_metadata(&path, "somebody else's", "");
    assert!(matches!(error(&path), ReadError::NotALog { .. }));
    with_metadata(&path, "vigil", "program=x");
    assert!(matches!(error(&path), ReadError::Metadata(_, "format")));

    let next = LOG_FORMAT + 1;
    with_metadata(&path, "vigil", &format!("format={next},program=firmware 9\x1b"));
    let version = error(&path);
    assert!(matches!(version, ReadError::Version(_, found, _) if found == next));
    assert!(version.to_string().contains("(firmware 9\\u{1b})"), "{version}");

    with_metadata(
        &path,
        "vigil",
        &format!("format={LOG_FORMAT},program=x,config=,instance=zero"),
    );
    assert!(matches!(error(&path), ReadError::Metadata(_, "instance")));
}
