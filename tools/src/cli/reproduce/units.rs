//! What is flown and computed: each unit of data is one or two other `vigil` commands, run in this process.

use super::data::{Data, Unit};
use crate::cli::output::{self, Interrupt, say};
use anyhow::{Context, Result};
use std::collections::BTreeMap;
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use vigil_detector::FrozenDetector;
use vigil_policy::FrozenActor;

/// How much is flown.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Size {
    Quick,
    Full,
}

/// A unit of data and how it is measured.
pub struct Spec {
    pub name: &'static str,
    /// For the line that says what is going on.
    pub what: &'static str,
    pub seeds: &'static str,
    /// Commands in their order, but for folder, threads, actor and detector.
    quick: &'static [&'static str],
    full: &'static [&'static str],
    /// Seconds of one core, quick and full, by which shards are balanced (docs/reproduce.md says how they were measured).
    cost_s: (u32, u32),
    /// What is kept.
    pub files: &'static [&'static str],
    /// What the last command needed and is large.
    scratch: &'static [&'static str],
}

/// In the order in which they are measured: what is done soon comes first.
pub const SPECS: [Spec; 16] = [
    Spec {
        name: "attack-deflection",
        what: "yaw bent in front of a wall",
        seeds: "sensor noise of seeds from 5000",
        quick: &["attack deflection --states 2 --seed 5000"],
        full: &["attack deflection --states 5 --seed 5000"],
        cost_s: (10, 24),
        files: &["table-2.json"],
        scratch: &[],
    },
    Spec {
        name: "detector-times",
        what: "time of decision, explanation and verdict",
        seeds: "validation course 7",
        quick: &["detector times --seed 7 --pictures 10"],
        full: &["detector times --seed 7 --pictures 20"],
        cost_s: (5, 10),
        files: &["times.json"],
        scratch: &[],
    },
    Spec {
        name: "explained",
        what: "a flight explained",
        seeds: "validation course 7",
        quick: &["detector figures --seed 7"],
        full: &["detector figures --seed 7"],
        cost_s: (2, 2),
        files: &["pixels.json", "explanations.csv"],
        scratch: &[],
    },
    Spec {
        name: "explained-attacked",
        what: "the same flight attacked and explained",
        seeds: "validation course 7",
        quick: &["detector figures --seed 7 --attacked --pictures 1"],
        full: &["detector figures --seed 7 --attacked --pictures 1"],
        cost_s: (3, 3),
        files: &["pixels.json", "explanations.csv"],
        scratch: &[],
    },
    Spec {
        name: "family-training",
        what: "training courses",
        seeds: "from 29000000",
        quick: &["evaluate --family training --flights 30 --seed 29000000"],
        full: &["evaluate --family training --flights 500 --seed 29000000"],
        cost_s: (9, 150),
        files: &["evaluate.json"],
        scratch: &[],
    },
    Spec {
        name: "family-validation",
        what: "validation courses",
        seeds: "from 29000000",
        quick: &["evaluate --family validation --flights 30 --seed 29000000"],
        full: &["evaluate --family validation --flights 500 --seed 29000000"],
        cost_s: (9, 150),
        files: &["evaluate.json"],
        scratch: &[],
    },
    Spec {
        name: "family-dense",
        what: "dense courses",
        seeds: "from 29000000",
        quick: &["evaluate --family dense --flights 30 --seed 29000000"],
        full: &["evaluate --family dense --flights 500 --seed 29000000"],
        cost_s: (9, 150),
        files: &["evaluate.json"],
        scratch: &[],
    },
    Spec {
        name: "family-hard",
        what: "hard courses",
        seeds: "from 29000000",
        quick: &["evaluate --family hard --flights 30 --seed 29000000"],
        full: &["evaluate --family hard --flights 500 --seed 29000000"],
        cost_s: (9, 150),
        files: &["evaluate.json"],
        scratch: &[],
    },
    Spec {
        name: "attack-completion",
        what: "completion, field on and off, attacked and not",
        seeds: "validation courses from 9000000",
        quick: &["attack completion --flights 20 --seed 9000000"],
        full: &["attack completion --flights 200 --seed 9000000"],
        cost_s: (48, 480),
        files: &["completion.json"],
        scratch: &[],
    },
    Spec {
        name: "attack-table",
        what: "states attacked at every strength",
        seeds: "states of validation courses from 5000",
        quick: &["attack table --states 60 --seed 5000"],
        full: &["attack table --states 1000 --seed 5000"],
        cost_s: (120, 2_000),
        files: &["figure-11.csv"],
        scratch: &["frames.png"],
    },
    Spec {
        name: "defended-100",
        what: "bursts of 100 steps, undefended and defended",
        seeds: "validation courses from 8300000",
        quick: &["attack defended --burst 100 --flights 10 --seed 8300000 --arms undefended,stop,recover --resume"],
        full: &["attack defended --burst 100 --flights 100 --seed 8300000 --arms undefended,stop,recover --resume"],
        cost_s: (44, 440),
        files: &["defended.csv"],
        scratch: &[],
    },
    Spec {
        name: "defended-continuous",
        what: "attacked all the time, undefended and defended",
        seeds: "validation courses from 8000000",
        quick: &["attack defended --burst continuous --flights 8 --seed 8000000 --resume"],
        full: &["attack defended --burst continuous --flights 200 --seed 8000000 --resume"],
        cost_s: (300, 7_400),
        files: &["defended.csv"],
        scratch: &[],
    },
    Spec {
        name: "defended-adaptive",
        what: "attacked by one who knows the detector",
        seeds: "validation courses from 8200000",
        quick: &[
            "attack defended --burst continuous --flights 4 --seed 8200000 --arms undefended,recover --evade DETECTOR --resume",
        ],
        full: &[
            "attack defended --burst continuous --flights 50 --seed 8200000 --arms undefended,recover --evade DETECTOR --resume",
        ],
        cost_s: (90, 1_130),
        files: &["defended.csv"],
        scratch: &[],
    },
    Spec {
        name: "defended-adaptive-unguarded",
        what: "the same without the guard",
        seeds: "validation courses from 8200000",
        quick: &[
            "attack defended --burst continuous --flights 3 --seed 8200000 --arms recover --evade DETECTOR --guard off --resume",
        ],
        full: &[
            "attack defended --burst continuous --flights 20 --seed 8200000 --arms recover --evade DETECTOR --guard off --resume",
        ],
        cost_s: (25, 166),
        files: &["defended.csv"],
        scratch: &[],
    },
    Spec {
        name: "detector-evaluate",
        what: "verdicts on attacks and controls",
        seeds: "validation courses from 6000",
        quick: &["detector evaluate --unattacked 40 --attacked 12 --other 4"],
        full: &["detector evaluate"],
        cost_s: (60, 220),
        files: &["evaluate.json"],
        scratch: &["evaluate.safetensors", "roc.png", "roc.svg"],
    },
    Spec {
        name: "detector-table",
        what: "four detectors on the same states",
        seeds: "states of training courses from 5000 and 5700, and of validation courses from 7000",
        quick: &["detector images --states 300 --judged 200", "detector table"],
        full: &["detector images --states 2000 --judged 2000", "detector table"],
        cost_s: (140, 1_000),
        files: &["table.json"],
        scratch: &[
            "images-learn.safetensors",
            "images-choose.safetensors",
            "images-judge.safetensors",
            "images-learn.flights",
            "images-choose.flights",
            "images-judge.flights",
            "fcn_ad.png",
            "cnn_ad.png",
        ],
    },
];

/// Units that only the repository has: training takes hours, and the peers need 5 GB of Python.
pub const COMMITTED_ONLY: [&str; 2] = ["training-runs", "peers"];

/// Whose decisions and verdicts are measured, by how many threads, how much.
pub struct Setting {
    pub actor: Option<PathBuf>,
    pub detector: Option<PathBuf>,
    pub actor_sha256: String,
    pub detector_sha256: String,
    pub threads: Option<u16>,
    pub size: Size,
    pub commit: String,
}

impl Setting {
    /// Loads actor and detector, to refuse them before the work.
    ///
    /// # Errors
    /// Files that are none, a detector of another actor.
    pub fn new(actor: Option<&Path>, detector: Option<&Path>, threads: Option<u16>, size: Size) -> Result<Self> {
        let (flying, judging) = (load_actor(actor)?, load_detector(detector)?);
        let sha256 = flying.sha256();
        anyhow::ensure!(
            judging.actor_sha256 == sha256,
            "the detector {} was trained for the actor {}, but the actor that flies is {sha256}: give --detector a detector of this \
             actor (`vigil detector train --actor FILE`)",
            detector.map_or("built in".to_owned(), |file| file.display().to_string()),
            judging.actor_sha256
        );
        Ok(Self {
            actor: actor.map(Path::to_owned),
            detector: detector.map(Path::to_owned),
            actor_sha256: sha256,
            detector_sha256: judging.sha256(),
            threads,
            size,
            commit: output::git_commit().unwrap_or_else(|| "unknown".to_owned()),
        })
    }
}

fn load_actor(file: Option<&Path>) -> Result<FrozenActor> {
    Ok(match file {
        Some(file) => FrozenActor::load(file)?,
        None => FrozenActor::built_in()?,
    })
}

fn load_detector(file: Option<&Path>) -> Result<FrozenDetector> {
    Ok(match file {
        Some(file) => FrozenDetector::load(file)?,
        None => FrozenDetector::built_in()?,
    })
}

impl Spec {
    fn lines(&self, size: Size) -> &'static [&'static str] {
        match size {
            Size::Quick => self.quick,
            Size::Full => self.full,
        }
    }

    /// The command as a user would type it in the repository.
    pub fn command(&self, setting: &Setting) -> String {
        let detector = setting
            .detector
            .as_ref()
            .map_or("detector/frozen/lstm_ad.safetensors".to_owned(), |file| {
                file.display().to_string()
            });
        let mut told = Vec::new();
        for line in self.lines(setting.size) {
            let mut words = format!("vigil {}", line.replace("DETECTOR", &detector).replace(" --resume", ""));
            for (name, file) in extra(line, setting) {
                words += &format!(" {name} {}", file.display());
            }
            told.push(words);
        }
        told.join(" && ")
    }

    /// Runs the commands. False when Ctrl-C came before they were done.
    ///
    /// # Errors
    /// Theirs.
    pub fn measure(
        &self,
        setting: &Setting,
        data: &mut Data,
        interrupt: &Interrupt,
        run: &dyn Fn(Vec<OsString>) -> Result<ExitCode>,
    ) -> Result<bool> {
        let folder = data.folder_of(self.name);
        std::fs::create_dir_all(&folder).with_context(|| format!("cannot make {}", folder.display()))?;
        // The attacker's copy: a campaign that is gone on with must name the same file.
        let copy = folder.join("known-detector.safetensors");
        for line in self.lines(setting.size) {
            if line.contains("DETECTOR") {
                load_detector(setting.detector.as_deref())?.save(&copy)?;
            }
            let mut words: Vec<OsString> = vec!["vigil".into()];
            words.extend(line.split(' ').map(|word| match word {
                "DETECTOR" => copy.clone().into_os_string(),
                word => word.into(),
            }));
            let place = match line.starts_with("evaluate") {
                true => folder.join(self.files[0]),
                false => folder.clone(),
            };
            words.extend(["-o".into(), place.into_os_string()]);
            if let Some(threads) = setting.threads {
                words.extend(["--threads".into(), threads.to_string().into()]);
            }
            for (name, file) in extra(line, setting) {
                words.extend([name.into(), file.as_os_str().to_owned()]);
            }
            output::quietly(|| run(words)).with_context(|| format!("vigil {line}"))?;
            if interrupt.came() {
                return Ok(false);
            }
        }
        for file in self.scratch.iter().chain(&["known-detector.safetensors"]) {
            // Not every size leaves each of them.
            let _ = std::fs::remove_file(folder.join(file));
        }
        data.enter(self.name, self.unit(setting), self.files)?;
        Ok(true)
    }

    /// What the index says of it, but for the files.
    pub fn unit(&self, setting: &Setting) -> Unit {
        Unit {
            command: self.command(setting),
            seeds: self.seeds.to_owned(),
            commit: setting.commit.clone(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            note: String::new(),
            files: BTreeMap::new(),
        }
    }

    /// What it costs, seconds of one core; only the proportions count.
    pub fn cost_s(&self, size: Size) -> u32 {
        match size {
            Size::Quick => self.cost_s.0,
            Size::Full => self.cost_s.1,
        }
    }
}

/// Actor and detector, by the names that the command has for them.
fn extra<'a>(line: &str, setting: &'a Setting) -> Vec<(&'static str, &'a PathBuf)> {
    let mut words = Vec::new();
    if let Some(actor) = &setting.actor {
        words.push(("--actor", actor));
    }
    let name = match line.split(' ').take(2).collect::<Vec<_>>()[..] {
        ["evaluate", ..] => Some("--detector-file"),
        ["attack", "defended"] | ["detector", "figures" | "times" | "evaluate" | "table"] => Some("--detector"),
        _ => None,
    };
    if let (Some(name), Some(file)) = (name, &setting.detector) {
        words.push((name, file));
    }
    words
}

/// Measures what is missing of some units. False when Ctrl-C came first.
///
/// # Errors
/// Those of the commands.
pub fn measure(
    names: &[&str],
    setting: &Setting,
    data: &mut Data,
    run: &dyn Fn(Vec<OsString>) -> Result<ExitCode>,
) -> Result<bool> {
    let interrupt = Interrupt::on_ctrl_c()?;
    let wanted: Vec<&Spec> = SPECS.iter().filter(|spec| names.contains(&spec.name)).collect();
    for (number, spec) in wanted.iter().enumerate() {
        let place = format!("[{}/{}] {}", number + 1, wanted.len(), spec.what);
        let command = spec.command(setting);
        if data.has(spec.name, &command) {
            say!("{place}: is there");
            continue;
        }
        say!("{place}: {command}");
        if interrupt.came() || !spec.measure(setting, data, &interrupt, run)? {
            return Ok(false);
        }
    }
    Ok(true)
}
