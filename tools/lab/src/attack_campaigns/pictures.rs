//! What each attack makes of the same frame: a plate of pictures.

use super::Common;
use super::states::met_in_flight;
use crate::report::{ColourScale, Picture, Plate};
use anyhow::{Context, Result};
use std::process::ExitCode;
use vigil_adversary::{AttackConfig, Method, StateAttack};
use vigil_nnet::Isa;
use vigil_tools::cli::output::{range_grey, say};
use vigil_types::YAW_RATE_PER_UNIT_RAD_S;

/// Changes of as many metres and more have the full colour.
const FULL_COLOUR_M: f32 = 8.0;
/// Something nearer than this, over the sensor's range of 100 m, is worth a picture.
const NEAR: f32 = 0.1;

/// Arguments of `vigil attack pictures`.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "\
Examples:
  vigil attack pictures -o runs/pictures                 attacks.svg and attacks.png: a frame of validation course 5000
  vigil attack pictures --seed 7                         of another course")]
pub struct PicturesArgs {
    /// Seed of the validation course.
    #[arg(long, default_value_t = 5000)]
    seed: u64,

    #[command(flatten)]
    common: Common,
}

/// Names and settings of the rows.
fn attacks() -> [([&'static str; 2], AttackConfig); 7] {
    let of = |method, epsilon_255, region_pixels| AttackConfig {
        method,
        epsilon_255,
        region_pixels,
        ..AttackConfig::PAPER
    };
    [
        (["FGSM", "ε = 10/255"], of(Method::Fgsm, 10.0, 1)),
        (["BIM, clipped", "ε = 1/255"], of(Method::BimClipped, 1.0, 1)),
        (["accumulating", "1/255 × 20"], of(Method::BimAccumulating, 1.0, 1)),
        (["in regions", "of 8 × 8 pixels"], of(Method::BimAccumulating, 1.0, 8)),
        (["patch", "5/255 × 20"], of(Method::Patch, 5.0, 1)),
        (["noise", "20/255"], of(Method::Noise, 1.0, 1)),
        (["recede", "1/255 × 20"], of(Method::Recede, 1.0, 1)),
    ]
}

/// Red nearer, blue farther, white as it was; −1 and 1 are full colours.
pub(super) fn change_colour(share: f32) -> [u8; 3] {
    let faded = (255.0 * (1.0 - share.abs().min(1.0))) as u8;
    if share < 0.0 {
        [255, faded, faded]
    } else {
        [faded, faded, 255]
    }
}

/// Draws them.
pub fn run(args: &PicturesArgs) -> Result<ExitCode> {
    let folder = args.common.folder()?;
    let victim = args.common.victim()?;
    let met = met_in_flight(&victim, args.seed)?;
    let state = met
        .iter()
        .max_by_key(|state| state.frame.iter().filter(|range| **range < NEAR).count())
        .context("the flight was over before the actor remembered anything")?;
    let clean = &state.frame;
    let grey = |frame: &[f32]| frame.iter().flat_map(|range| range_grey(*range)).collect::<Vec<u8>>();
    let change = |frame: &[f32]| -> Vec<u8> {
        let moved_m = frame.iter().zip(clean).map(|(x, clean)| 100.0 * (x - clean));
        moved_m.flat_map(|m| change_colour(m / FULL_COLOUR_M)).collect()
    };
    let mut rows = vec![(vec!["as taken".to_owned()], [grey(clean), change(clean)])];
    for (name, config) in attacks() {
        let mut attack = StateAttack::new(Isa::detect(), &victim, &config)?;
        let mut frame = clean.clone();
        let outcome = attack.attack(&mut frame, &state.beside)?;
        let turned_deg_s = (outcome.yaw_change() * YAW_RATE_PER_UNIT_RAD_S).to_degrees();
        let mut words = name.map(str::to_owned).to_vec();
        words.push(format!("yaw {turned_deg_s:+.0} °/s").replace('-', "−"));
        rows.push((words, [grey(&frame), change(&frame)]));
    }
    let place = |m: f32| f64::from(0.5 + 0.5 * m / FULL_COLOUR_M);
    let tick = |m: f32| (place(m), format!("{m}").replace('-', "−"));
    let changes = ColourScale {
        label: "change of the range (m): red nearer, blue farther".to_owned(),
        ticks: [-FULL_COLOUR_M, 0.0, FULL_COLOUR_M].map(tick).into(),
        colours: (-127..=127).map(|i| change_colour(i as f32 / 127.0)).collect(),
    };
    let plate = Plate {
        title: format!("What attacks make of a frame of validation course {}", args.seed),
        columns: [("as delivered", ColourScale::of_ranges()), ("change", changes)],
        rows,
    };
    for path in plate.save(folder, "attacks")?.iter().rev() {
        say!("picture   {}", path.display());
    }
    Ok(ExitCode::SUCCESS)
}
