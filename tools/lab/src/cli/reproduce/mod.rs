//! `vigil reproduce`: the paper's tables and figures and ours, from committed data or from flights flown anew, on one page.

mod data;
mod items;
mod made;
mod ours;
mod page;
mod paper;
mod units;

use crate::campaign::flights::{program_sha256, sha256};
use crate::cli::detector::detector_of;
use crate::cli::output::{self, EXIT_INTERRUPTED, put, say};
use crate::report::TextTable;
use anyhow::{Context, Result, ensure};
use data::{Data, Sources};
use items::{ITEMS, Item};
use made::Made;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use units::{COMMITTED_ONLY, Setting};
use vigil_policy::FrozenActor;

/// Arguments of `vigil reproduce`.
#[derive(Debug, Clone, Default, clap::Args)]
#[command(after_help = "\
Examples:
  vigil reproduce --committed                  from what the repository holds: seconds, nothing is flown
  vigil reproduce --quick                      flown anew with few flights: a quarter of an hour on two cores
  vigil reproduce                              flown anew with as many flights as the figures need: hours
  vigil reproduce --committed --only table-1,figure-9
  vigil reproduce --only table-3 -o runs/1     on another machine
  vigil reproduce --from runs/1 -o runs/all    the page of all, of which runs/1 has some measured already
  vigil reproduce --list                       what there is

The folder then holds index.html (one file, which needs no network), figures/*.svg and *.png (300 dpi), tables/*.csv,
manifest.json, and in data/ what was measured. Ctrl-C keeps what is whole; the same command goes on with it. The training
runs of table I and figures 9 and 10 and the comparison with other programs are always the committed ones: `vigil learn`
and tools/peers/run.sh make them. docs/reproduce.md explains it.
Exit code: 0 all is there, 1 error, 130 interrupted.")]
pub struct ReproduceArgs {
    /// Draw from the committed data alone; nothing is flown.
    #[arg(long, conflicts_with_all = ["quick", "actor", "detector"])]
    committed: bool,

    /// Fly few flights: the intervals are wide, and every item says so.
    #[arg(long)]
    quick: bool,

    /// Only these tables and figures.
    #[arg(long, value_name = "ITEM,…", value_delimiter = ',')]
    only: Vec<String>,

    /// Name the tables and figures, and what each is made of.
    #[arg(long)]
    list: bool,

    /// The folder for all of it.
    #[arg(short, long, value_name = "DIR", default_value = "runs/reproduce")]
    output: PathBuf,

    /// The committed data.
    #[arg(long, value_name = "DIR", default_value = "docs/measured")]
    data: PathBuf,

    /// The frozen actor that is measured [default: the one built in].
    #[arg(long, value_name = "FILE")]
    actor: Option<PathBuf>,

    /// The frozen detector that is measured; it must be this actor's [default: the one built in].
    #[arg(long, value_name = "FILE")]
    detector: Option<PathBuf>,

    /// Take what was measured in the folders of other runs, on other machines, instead of measuring it again.
    #[arg(long, value_name = "DIR,…", value_delimiter = ',', conflicts_with_all = ["committed", "list"])]
    from: Vec<PathBuf>,

    /// Threads; all cores when absent.
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
}

/// What a folder of results was made by. Results of two programs are not mixed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct MadeBy {
    version: String,
    /// SHA-256 of the program's file.
    #[serde(default)]
    program: String,
    commit: String,
    mode: String,
    actor_sha256: String,
    detector_sha256: String,
}

const MADE_BY: &str = "made-by.toml";
/// Some lines of TOML, bytes.
const SMALL_FILE: u64 = 1 << 16;

impl MadeBy {
    /// Loads actor and detector, to refuse them before the work.
    ///
    /// # Errors
    /// Files that are none, a detector of another actor.
    fn by(args: &ReproduceArgs) -> Result<Self> {
        let actor = args.actor.as_deref();
        let actor_sha256 = actor.map_or_else(FrozenActor::built_in, FrozenActor::load)?.sha256();
        let mode = match (args.committed, args.quick) {
            (true, _) => "committed",
            (false, true) => "quick",
            (false, false) => "full",
        };
        Ok(Self {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            program: program_sha256()?,
            commit: output::git_commit().unwrap_or_else(|| "unknown".to_owned()),
            mode: mode.to_owned(),
            detector_sha256: detector_of(&actor_sha256, args.detector.as_deref())?.sha256(),
            actor_sha256,
        })
    }

    /// Makes the folder, or finds it made by the same.
    fn claim(&self, folder: &Path) -> Result<()> {
        std::fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
        let path = folder.join(MADE_BY);
        if path.exists() {
            self.expect_in(folder, "; name another folder with --output, or remove it")?;
        } else {
            let mut entries = std::fs::read_dir(folder).with_context(|| format!("cannot read {}", folder.display()))?;
            ensure!(
                entries.next().is_none(),
                "{} holds other files; name an empty or a new folder with --output",
                folder.display()
            );
        }
        // What cannot be written is refused before the work.
        output::write(&path, toml::to_string_pretty(self)?)
    }

    /// Fails where a folder's results are of something else, with all that differs and `advice`.
    fn expect_in(&self, folder: &Path, advice: &str) -> Result<()> {
        let path = folder.join(MADE_BY);
        let text = vigil_types::files::read_text(&path, SMALL_FILE)
            .with_context(|| format!("cannot read {}", path.display()))?;
        let own: Self = toml::from_str(&text).with_context(|| format!("{} is damaged", path.display()))?;
        let differences: Vec<String> = [
            ("version", own.version, &self.version),
            ("program", own.program, &self.program),
            ("commit", own.commit, &self.commit),
            ("mode", own.mode, &self.mode),
            ("actor", own.actor_sha256, &self.actor_sha256),
            ("detector", own.detector_sha256, &self.detector_sha256),
        ]
        .into_iter()
        .filter(|(_, own, this)| own != *this)
        .map(|(what, own, this)| format!("its {what} is {own}, this one's {this}"))
        .collect();
        ensure!(
            differences.is_empty(),
            "{} holds results of something else: {}{advice}",
            folder.display(),
            differences.join("; ")
        );
        Ok(())
    }
}

/// An item and where its numbers come from.
struct Shown<'a> {
    item: &'a Item,
    made: Made,
    sources: Vec<Source<'a>>,
}

/// What `manifest.json` says of an item.
#[derive(Serialize)]
struct Entry<'a> {
    id: &'a str,
    kind: &'static str,
    title: &'a str,
    caption: &'a str,
    /// Each file, and its SHA-256.
    files: BTreeMap<String, String>,
    sources: &'a [Source<'a>],
}

/// A unit, and whether it was measured now.
#[derive(Serialize)]
struct Source<'a> {
    unit: &'a str,
    command: &'a str,
    seeds: &'a str,
    commit: &'a str,
    version: &'a str,
    note: &'a str,
    flown_anew: bool,
}

#[derive(Serialize)]
struct Manifest<'a> {
    made_by: &'a MadeBy,
    items: Vec<Entry<'a>>,
}

/// Measures what is missing, and makes the tables, figures and page.
///
/// # Errors
/// Unknown items, data that are missing or damaged, a folder of something else, an actor or detector that is none.
pub fn run(args: &ReproduceArgs) -> Result<ExitCode> {
    if args.list {
        put!("{}\n", list());
        return Ok(ExitCode::SUCCESS);
    }
    let items = chosen(&args.only)?;
    let made_by = &MadeBy::by(args)?;
    let setting = Setting { args, made_by };
    let committed = Data::committed(&args.data)?;
    made_by.claim(&args.output)?;
    let mut whole = true;
    let fresh = match args.committed {
        true => None,
        false => {
            let folder = args.output.join("data");
            std::fs::create_dir_all(&folder).with_context(|| format!("cannot make {}", folder.display()))?;
            let mut fresh = Data::open(&folder, true)?;
            let names: Vec<&str> = items.iter().flat_map(|item| item.units()).collect();
            for folder in &args.from {
                made_by.expect_in(folder, "")?;
                units::take(&names, &setting, &Data::open(&folder.join("data"), true)?, &mut fresh)?;
            }
            whole = units::measure(&names, &setting, &mut fresh, &super::run_words)?;
            Some(fresh)
        }
    };
    let sources = Sources { fresh, committed };
    // After an interruption only what was measured now, so that nothing old stands for it.
    let ready = |item: &&Item| {
        let there = |unit| COMMITTED_ONLY.contains(&unit) || sources.of(unit).is_fresh;
        args.committed || item.units().all(there)
    };
    let made = items.iter().copied().filter(ready).map(|item| show(item, &sources));
    let made: Vec<Shown> = made.collect::<Result<_>>()?;
    write(&args.output, made_by, &made)?;
    let page = args.output.join("index.html");
    say!("{} tables and figures: {}", made.len(), page.display());
    if !whole {
        say!("interrupted: what is whole is kept; the same command goes on");
        return Ok(ExitCode::from(EXIT_INTERRUPTED));
    }
    Ok(ExitCode::SUCCESS)
}

fn list() -> String {
    let mut table = TextTable::new("item | what | made of");
    for item in &ITEMS {
        table.row([
            item.id.to_owned(),
            item.title.to_owned(),
            item.units().collect::<Vec<_>>().join(", "),
        ]);
    }
    table.to_string()
}

fn chosen(only: &[String]) -> Result<Vec<&'static Item>> {
    let named: Vec<&String> = only.iter().filter(|name| !name.is_empty()).collect();
    ensure!(
        only.is_empty() || !named.is_empty(),
        "--only names nothing; `vigil reproduce --list` names the tables and figures"
    );
    for name in named {
        ensure!(
            ITEMS.iter().any(|item| item.id == name),
            "there is no {name}; `vigil reproduce --list` names the tables and figures"
        );
    }
    let wanted = |item: &&Item| only.is_empty() || only.iter().any(|name| name == item.id);
    Ok(ITEMS.iter().filter(wanted).collect())
}

fn show<'a>(item: &'a Item, sources: &'a Sources) -> Result<Shown<'a>> {
    let of = |unit: &'static str| {
        let data = sources.of(unit);
        let known = data.unit(unit)?;
        Some(Source {
            unit,
            command: &known.command,
            seeds: &known.seeds,
            commit: &known.commit,
            version: &known.version,
            note: &known.note,
            flown_anew: data.is_fresh,
        })
    };
    Ok(Shown {
        item,
        made: (item.make)(sources).with_context(|| format!("{} cannot be made", item.id))?,
        sources: item.units().filter_map(of).collect(),
    })
}

/// Writes each file, the page, and last the manifest that names them.
fn write(folder: &Path, made_by: &MadeBy, all: &[Shown]) -> Result<()> {
    for name in ["figures", "tables"] {
        let inner = folder.join(name);
        std::fs::create_dir_all(&inner).with_context(|| format!("cannot make {}", inner.display()))?;
    }
    let mut items = Vec::new();
    for Shown { item, made, sources } in all {
        let mut files = BTreeMap::new();
        let mut keep = |name: String, content: &[u8]| {
            output::write(&folder.join(&name), content)?;
            files.insert(name, sha256(content));
            Ok::<_, anyhow::Error>(())
        };
        if let Some((svg, png)) = &made.figure {
            keep(format!("figures/{}.svg", item.id), svg.as_bytes())?;
            keep(format!("figures/{}.png", item.id), png)?;
        }
        keep(format!("tables/{}.csv", item.id), made.table.csv().as_bytes())?;
        items.push(Entry {
            id: item.id,
            kind: if made.figure.is_some() { "figure" } else { "table" },
            title: item.title,
            caption: &made.caption,
            files,
            sources,
        });
    }
    output::write(&folder.join("index.html"), page::html(made_by, all))?;
    let manifest = Manifest { made_by, items };
    output::write(&folder.join("manifest.json"), serde_json::to_string_pretty(&manifest)?)
}
