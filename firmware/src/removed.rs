//! What an earlier version had and this one has not: commands, arguments and keys of files, each with what replaces it.

use std::io::Write as _;

const CONSTANTS: &str =
    "the guard's thresholds are constants (docs/detection.md); `--guard off`, `guard = false`, leaves the guard out";
const FLOAT32: &str = "the actor calculates in float32: leave it out";
const FROM_NOTHING: &str = "`vigil learn` begins from nothing; `--encoder-of` takes over an actor's encoder";
const NO_PLANNER: &str = "no planner shows an actor its path any more: leave it out";

/// Names as they were written, and what to do instead. Kept for one version.
type Removed = [(&'static str, &'static str)];

/// Of the command line.
const ARGUMENTS: &Removed = &[
    (
        "train",
        "training by imitation is gone: `vigil learn` trains an actor from nothing",
    ),
    (
        "harden",
        "there is nothing in its place: see docs/robustness.md for what defends the actor",
    ),
    (
        "certify",
        "there is nothing in its place: `vigil attack table` attacks the same states",
    ),
    (
        "learn --learned",
        "the learned adversary is gone: `--attack recede` finds as much",
    ),
    (
        "--knows",
        "the geometric pilot follows movers by its frames alone: leave it out",
    ),
    ("--encoder", FLOAT32),
    (
        "--shard",
        "seeds are the shards: fly others on each machine (`--seed`, `--flights`), and `vigil merge` what they leave (docs/cluster.md)",
    ),
    ("--astray --disagreement --smooth-share --guard-final", CONSTANTS),
];

/// Of `vigil learn` alone.
const LEARNING: &Removed = &[
    (
        "nothing expert actor --expert",
        "`vigil learn` has one recipe, from nothing: leave it out",
    ),
    ("--from", FROM_NOTHING),
    ("--led-by", NO_PLANNER),
];

/// Keys of the firmware's configuration.
const CONFIGURATION: &Removed = &[
    ("encoder", FLOAT32),
    (
        "astray_m disagreement_s smooth_share guard_final unknown_steps",
        CONSTANTS,
    ),
];

/// Keys and values of a training file. The firmware's configuration has an `apf` of its own.
const TRAINING: &Removed = &[
    (
        "sees frames slope_states actor_units critics_first expert_critics freeze_target imitation twin value_weight \
         imitation_falls_over imitation_stays imitation_width imitation_updates imitation_trains_encoder \
         encoder_frames teacher apf",
        "training by imitation, experts and actors of five frames are gone: leave it out \
         (`vigil learn --print-config`)",
    ),
    ("warm_up_by_actor", FROM_NOTHING),
    ("led_by", NO_PLANNER),
    ("way", "it is called `path`"),
];

/// What replaces a command, an argument (with its dashes), a key or a value, if this version has dropped it.
fn replaced_by(removed: &Removed, name: &str) -> Option<&'static str> {
    let mut rows = removed.iter();
    let row = rows.find(|(names, _)| names.split(' ').any(|one| one == name));
    row.map(|(_, instead)| *instead)
}

/// The report of a parser that refused a training file, with what replaces the key or the value that is unknown.
pub fn explain(report: String) -> String {
    explained(report, TRAINING)
}

/// The same of the firmware's configuration.
pub(crate) fn explain_configuration(report: String) -> String {
    explained(report, CONFIGURATION)
}

fn explained(report: String, removed: &Removed) -> String {
    let unknown = report
        .split_once("there is no ")
        .and_then(|(_, rest)| rest.trim_start_matches("key ").split(['`', '"']).nth(1));
    match unknown.and_then(|name| Some((name, replaced_by(removed, name)?))) {
        Some((name, instead)) => format!("{report}\n`{name}` is of an earlier version: {instead}"),
        None => report,
    }
}

/// Reads the arguments of the process, or ends it with what is wrong and what replaces a word that is unknown.
pub fn parse<P: clap::Parser>() -> P {
    P::try_parse().unwrap_or_else(|error| {
        use clap::error::{ContextKind, ContextValue};
        let learns = std::env::args_os().any(|word| word == "learn");
        let unknown = [ContextKind::InvalidSubcommand, ContextKind::InvalidArg].map(|kind| error.get(kind));
        let instead = unknown.into_iter().flatten().find_map(|word| match word {
            ContextValue::String(word) if learns => {
                replaced_by(LEARNING, word).or_else(|| replaced_by(ARGUMENTS, word))
            }
            ContextValue::String(word) => replaced_by(ARGUMENTS, word),
            _ => None,
        });
        let printed = error.print().and_then(|()| std::io::stdout().flush());
        if let Some(instead) = instead {
            // Where nobody listens, nothing can be said.
            let _ = writeln!(std::io::stderr(), "\nIt is of an earlier version: {instead}");
        }
        let mut code = error.exit_code();
        if let Err(lost) = printed
            && !vigil_types::files::reader_has_gone(&lost)
        {
            let _ = writeln!(std::io::stderr(), "cannot write standard output: {lost}");
            code = code.max(1);
        }
        std::process::exit(code)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_file_of_an_earlier_version_names_is_explained_in_that_file_and_in_no_other() {
        for (unknown, configuration, training) in [
            ("key `encoder`", "float32", ""),
            ("key `twin`", "", "imitation"),
            ("key `apf`", "", "imitation"),
            ("\"way\"", "", "`path`"),
            ("key `actor`", "", ""),
        ] {
            let report = format!("line 3, column 1: there is no {unknown} here, only `seed`");
            for (explained, part) in [
                (explain_configuration(report.clone()), configuration),
                (explain(report.clone()), training),
            ] {
                let added = explained.strip_prefix(&report).unwrap();
                assert!(
                    added.contains(part) && added.is_empty() == part.is_empty(),
                    "{explained}"
                );
            }
        }
        let named = ["actor", "--from", "--led-by"].map(|word| replaced_by(LEARNING, word));
        assert!(named.iter().all(Option::is_some), "{named:?}");
    }
}
