//! Writes a flight log as the plain recording that the bare-metal image replays (docs/boards.md).
//!
//! `cargo run --release -p vigil-firmware --example flight_for_a_board -- flight.mcap flight.bin`

#[path = "../bare/src/recording.rs"]
mod recording;

use anyhow::{Context, Result, ensure};
use recording::{Digest, HAS_FRAME, KNOWN_ALTERED, MAGIC, Setup};
use std::io::Write;
use std::path::Path;
use vigil_firmware::FirmwareConfig;
use vigil_log::{Reader, TickRecord};
use vigil_types::{Datagrams, DepthFrame, PilotKind, Reason};

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [log, out] = arguments.as_slice() else {
        anyhow::bail!("usage: flight_for_a_board FLIGHT.mcap RECORDING.bin");
    };
    let mut reader = Reader::open(Path::new(log))?;
    // Refuses a flight that cannot be replayed here, with the reason: without frames, with other models.
    drop(vigil_firmware::replay::firmware_of(&reader)?);
    let config = FirmwareConfig::from_toml(&reader.info().config_toml).map_err(anyhow::Error::msg)?;
    ensure!(
        config.pilot.kind == PilotKind::Actor && config.pilot.actor_file.is_none() && config.detector.file.is_none(),
        "the image has the built-in actor and detector: give it a flight of theirs"
    );
    ensure!(
        config.frame_key_files.is_empty(),
        "the flight's frames are authenticated: the image has no keys"
    );
    let detector = config
        .frozen_detector()?
        .context("the flight was flown without the detector: the image flies with it")?;
    let goal = config
        .goal
        .context("the flight had no goal at its start: the image needs one")?;
    let mut setup = Setup {
        goal_ned_m: [goal.north_m, goal.east_m, -goal.height_m.unwrap_or(config.height_m)],
        threshold: config.detector.threshold.unwrap_or(detector.threshold),
        field: config.pilot.apf,
        config: Digest::of(&config.stack()),
        steps: 0,
    };
    ensure!(
        setup.config == Digest::of(&setup.stack()),
        "the flight's configuration differs from the default in more than goal, height, threshold and field:\n{:#?}\nthe image's:\n{:#?}",
        config.stack(),
        setup.stack()
    );
    let mut steps = Vec::new();
    let mut record = Box::<TickRecord>::default();
    while reader.read_next(&mut record)? {
        if record.dropped_before > 0 {
            break;
        }
        write_step(&mut steps, &record)?;
        setup.steps += 1;
    }
    ensure!(setup.steps > 0, "the log has no steps");
    let mut file = std::io::BufWriter::new(std::fs::File::create(out).with_context(|| format!("cannot write {out}"))?);
    file.write_all(&MAGIC)?;
    for value in setup.goal_ned_m {
        file.write_all(&value.to_le_bytes())?;
    }
    file.write_all(&setup.threshold.to_le_bytes())?;
    file.write_all(&u32::from(setup.field).to_le_bytes())?;
    file.write_all(&setup.steps.to_le_bytes())?;
    file.write_all(&setup.config.to_le_bytes())?;
    file.write_all(&steps)?;
    file.flush()?;
    println!("{out}: {} steps, {} bytes", setup.steps, 40 + steps.len());
    Ok(())
}

fn write_step(out: &mut Vec<u8>, record: &TickRecord) -> Result<()> {
    let timing = &record.timing;
    for value in [
        record.now_ns,
        timing.step,
        timing.previous_execution_ns,
        timing.wake_late_ns,
        timing.slips,
        Digest::of(&record.report),
    ] {
        out.write_all(&value.to_le_bytes())?;
    }
    let altered = record.report.reasons.contains(Reason::UnauthenticatedFrame);
    let flags = if record.frame().is_some() { HAS_FRAME } else { 0 } | if altered { KNOWN_ALTERED } else { 0 };
    out.write_all(&flags.to_le_bytes())?;
    write_datagrams(out, &record.received)?;
    write_datagrams(out, &record.sent)?;
    if let Some(DepthFrame { header, depth }) = record.frame() {
        out.write_all(&header.stamp_ns.to_le_bytes())?;
        out.write_all(&header.sequence.to_le_bytes())?;
        out.write_all(&header.sensor_id.to_le_bytes())?;
        out.write_all(&header.rows.to_le_bytes())?;
        out.write_all(&header.cols.to_le_bytes())?;
        let (at, turn) = (header.position_ned_m, header.attitude);
        for value in [at.x, at.y, at.z, turn.w, turn.x, turn.y, turn.z] {
            out.write_all(&value.to_le_bytes())?;
        }
        out.write_all(&header.reserved.to_le_bytes())?;
        out.write_all(&header.checksum.to_le_bytes())?;
        out.write_all(&header.tag)?;
        for value in depth {
            out.write_all(&value.to_le_bytes())?;
        }
    }
    Ok(())
}

fn write_datagrams(out: &mut Vec<u8>, datagrams: &Datagrams) -> Result<()> {
    out.write_all(&(datagrams.len() as u32).to_le_bytes())?;
    for (link, bytes) in datagrams.iter() {
        out.write_all(&[link])?;
        out.write_all(&u16::try_from(bytes.len())?.to_le_bytes())?;
        out.write_all(bytes)?;
    }
    Ok(())
}
