//! The adversary as a process of its own, between the raw and the delivered frame service.

use crate::{AttackArgs, AttackRecord};
use anyhow::{Result, bail};
use hdrhistogram::Histogram;
use serde::Serialize;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::atomic::Ordering;
use std::time::Duration;
use vigil_io::clock::monotonic_ns;
use vigil_io::shared_memory::{DEPTH_TOPIC, Domain, FramePublisher, FrameSubscriber};
use vigil_log::SideLog;
use vigil_types::{DepthFrame, NedVector};

/// The service on which the simulator publishes when an adversary stands behind it.
pub const RAW_TOPIC: &str = "depth-raw";
/// Time between two looks for a frame.
const LOOK: Duration = Duration::from_micros(200);
/// Steps are counted from the first frame taken at this share of the flight height.
const UNDER_WAY: f32 = 0.8;

/// Arguments of `vigil adversary`.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "\
Examples:
  vigil fly --pilot actor --attack bim-accumulating --burst continuous      starts simulator, adversary and firmware

  vigil sim --frames depth-raw                                              the same by hand, each in a terminal of its own
  vigil adversary --goal 20,5 --attack bim-accumulating --burst 50
  vigil firmware --goal 20,5 --height 1.5 --engage auto --pilot actor

Ends on Ctrl-C with one JSON line: frames, what was altered, how long it took.")]
pub struct AdversaryArgs {
    /// The attack.
    #[command(flatten)]
    pub attack: AttackArgs,

    /// Where the vehicle flies to, metres north and east of home.
    #[arg(long, value_name = "NORTH,EAST", value_parser = parse_pair, allow_hyphen_values = true)]
    pub goal: (f32, f32),

    /// Flight height, metres.
    #[arg(long, value_name = "M", default_value_t = 1.5)]
    pub height: f32,

    /// Decides when a burst comes and what is drawn at random.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,

    /// The actor that flies, if it is not the built-in one.
    #[arg(long, value_name = "FILE")]
    pub actor: Option<PathBuf>,

    /// A frame goes on this long after its capture at the latest, whatever iterations are left.
    #[arg(long, value_name = "MS", default_value_t = 35.0)]
    pub deadline_ms: f64,

    /// Note each frame in this file, and some as they were before they were altered, for the flight's log.
    #[arg(long, value_name = "FILE", hide = true)]
    pub record: Option<PathBuf>,

    /// The service that the sensor publishes on.
    #[arg(long, value_name = "TOPIC", default_value = RAW_TOPIC)]
    pub from: String,

    /// The service that the firmware reads.
    #[arg(long, value_name = "TOPIC", default_value = DEPTH_TOPIC)]
    pub to: String,

    /// Number of this set of processes; shared memory follows from it.
    #[arg(long, default_value_t = 0, value_parser = clap::value_parser!(u32).range(0..=99))]
    pub instance: u32,
}

fn parse_pair(text: &str) -> Result<(f32, f32), String> {
    let (north, east) = text.split_once(',').ok_or("give two numbers: NORTH,EAST")?;
    let number = |text: &str| match text.trim().parse::<f32>() {
        Ok(value) if value.is_finite() => Ok(value),
        _ => Err(format!("`{text}` is not a number")),
    };
    Ok((number(north)?, number(east)?))
}

#[derive(Serialize)]
struct Summary {
    frames: u64,
    cut_short: u64,
    #[serde(flatten)]
    attack: AttackRecord,
    /// From a frame's arrival here to its delivery.
    latency_p50_ms: f64,
    latency_p99_ms: f64,
    latency_max_ms: f64,
}

/// Passes frames on, altered or not, until Ctrl-C.
///
/// # Errors
/// No attack asked for, a bad actor or ε, another publisher on the delivered service.
pub fn run(args: &AdversaryArgs) -> Result<ExitCode> {
    let Some(attack) = args.attack.attack(args.actor.as_deref())? else {
        bail!("say what to do to the frames: --attack METHOD (see `vigil adversary --help`)");
    };
    let (north_m, east_m) = args.goal;
    let goal_ned_m = NedVector::new(north_m, east_m, -args.height);
    let mut interceptor = attack.interceptor(args.seed, goal_ned_m)?;
    let stop = vigil_io::interrupt::set_by_interrupt()?;
    let domain = Domain::open(args.instance, "adversary")?;
    let mut from = FrameSubscriber::create(&domain, &args.from)?;
    let mut to = FramePublisher::create(&domain, &args.to)?;
    let deadline_ns = (args.deadline_ms * 1e6) as u64;

    let mut notes = args.record.as_deref().map(SideLog::create).transpose()?;
    let mut frame = Box::new(DepthFrame::EMPTY);
    let mut clean = frame.clone();
    let mut latency_us = Histogram::<u64>::new_with_bounds(1, 10_000_000, 3)?;
    let (mut frames, mut cut_short, mut under_way) = (0, 0, 0);
    let mut record = AttackRecord::default();
    while !stop.load(Ordering::Relaxed) {
        match from.newest()? {
            Some(borrowed) => (*frame).clone_from(&borrowed),
            None => {
                std::thread::sleep(LOOK);
                continue;
            }
        }
        let (taken_ns, stamp_ns) = (monotonic_ns(), frame.header.stamp_ns);
        let waits = under_way == 0 && frame.header.position_ned_m.z > UNDER_WAY * goal_ned_m.z;
        let mut attacked = None;
        if !waits {
            if notes.is_some() {
                (*clean).clone_from(&frame);
            }
            let mut in_time = true;
            attacked = interceptor.pass_while(under_way, &mut frame, || {
                in_time = monotonic_ns() < stamp_ns.saturating_add(deadline_ns);
                in_time
            })?;
            record.observe(under_way, attacked.as_ref());
            cut_short += u64::from(!in_time);
            under_way += 1;
        }
        to.publish(&frame)?;
        // After it was handed on: the note costs the frame no time.
        if let Some(notes) = &mut notes {
            let altered = attacked.map(|outcome| (outcome.yaw_change(), &*clean));
            notes.frame(monotonic_ns(), frame.header.sequence, altered)?;
        }
        frames += 1;
        // A value beyond the histogram's range counts as its largest.
        latency_us.saturating_record((monotonic_ns() - taken_ns) / 1000);
    }
    if let Some(notes) = notes {
        notes.finish()?;
    }
    let ms = |us: u64| us as f64 * 1e-3;
    let summary = Summary {
        frames,
        cut_short,
        attack: record,
        latency_p50_ms: ms(latency_us.value_at_quantile(0.5)),
        latency_p99_ms: ms(latency_us.value_at_quantile(0.99)),
        latency_max_ms: ms(latency_us.max()),
    };
    vigil_types::files::print_line(&serde_json::to_string(&summary)?)?;
    Ok(ExitCode::SUCCESS)
}
