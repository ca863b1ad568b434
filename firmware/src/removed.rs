//! What an earlier version had and this one has not: commands, arguments and configuration keys, each with what replaces it.

/// Names as they were written, and what to do instead. Kept for one version.
const REMOVED: [(&str, &str); 9] = [
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
        "nothing expert --expert",
        "`vigil learn` has one recipe, from nothing: leave it out",
    ),
    (
        "--knows",
        "the geometric pilot follows movers by its frames alone: leave it out",
    ),
    ("--encoder encoder", "the actor calculates in float32: leave it out"),
    (
        "--shard",
        "seeds are the shards: fly others on each machine (`--seed`, `--flights`), and `vigil merge` what they leave (docs/cluster.md)",
    ),
    (
        "--astray --disagreement --smooth-share --guard-final astray_m disagreement_s smooth_share guard_final unknown_steps",
        "the guard's thresholds are constants (docs/detection.md); `--guard off`, `guard = false`, leaves the guard out",
    ),
];

/// What replaces a command, an argument (with its dashes) or a key of a configuration, if this version has dropped it.
pub fn replaced_by(name: &str) -> Option<&'static str> {
    let row = REMOVED
        .iter()
        .find(|(removed, _)| removed.split(' ').any(|one| one == name));
    row.map(|(_, instead)| *instead)
}

/// The report of a parser that refused a configuration, with what replaces the key that is unknown.
pub(crate) fn explain(report: String) -> String {
    let key = report
        .split_once("there is no key `")
        .and_then(|(_, rest)| rest.split_once('`'));
    match key.and_then(|(key, _)| Some((key, replaced_by(key)?))) {
        Some((key, instead)) => format!("{report}\n`{key}` is of an earlier version: {instead}"),
        None => report,
    }
}

/// Reads the arguments of the process, or ends it with what is wrong and what replaces a word that is unknown.
pub fn parse<P: clap::Parser>() -> P {
    P::try_parse().unwrap_or_else(|error| {
        use clap::error::{ContextKind, ContextValue};
        let unknown = [ContextKind::InvalidSubcommand, ContextKind::InvalidArg].map(|kind| error.get(kind));
        let instead = unknown.into_iter().flatten().find_map(|word| match word {
            ContextValue::String(word) => replaced_by(word),
            _ => None,
        });
        match instead {
            Some(instead) => {
                // Where nobody listens, nothing can be said.
                let _ = error.print();
                let _ = std::io::Write::write_fmt(
                    &mut std::io::stderr(),
                    format_args!("\nIt is of an earlier version: {instead}\n"),
                );
                std::process::exit(error.exit_code())
            }
            None => error.exit(),
        }
    })
}
