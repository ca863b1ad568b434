//! `vigil reproduce` on more than one machine: which units a shard measures, and how the folders of all shards become one.

use super::data::{Data, Unit};
use super::items::Item;
use super::units::{SPECS, Setting, Size, Spec};
use super::{MadeBy, SMALL_FILE, chosen};
use crate::campaign::part::{Program, Shard};
use crate::cli::output;
use anyhow::{Context, Result, bail, ensure};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Tells a shard's folder from a whole one.
const PART: &str = "part.toml";

/// What a shard's folder is a part of: everything that decides what is measured and is not in `made-by.toml`.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PartOf {
    shard: Shard,
    /// The tables and figures that the whole shows.
    items: Vec<String>,
    /// `--actor` and `--detector` as they were typed, because the commands of the units name them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    actor: Option<PathBuf>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    detector: Option<PathBuf>,
    program: Program,
}

/// The measured units of some items, each once, in the order in which they are measured.
fn units_of(items: &[&Item]) -> Vec<&'static Spec> {
    let wanted = |spec: &&Spec| items.iter().any(|item| item.units.contains(&spec.name));
    SPECS.iter().filter(wanted).collect()
}

/// The units of each of `of` shards: the costliest unit first, each to the shard that has least to do so far (of equals to the one with
/// the lower number). The same on every machine, since it depends on nothing but the units.
fn shares(units: &[&'static Spec], of: u64, size: Size) -> Vec<Vec<&'static str>> {
    let mut by_cost = units.to_vec();
    // Stable: of equals the first stays the first.
    by_cost.sort_by_key(|spec| std::cmp::Reverse(spec.cost_s(size)));
    let mut shares: Vec<(u32, Vec<&'static str>)> = (0..of).map(|_| (0, Vec::new())).collect();
    for spec in by_cost {
        if let Some((cost_s, names)) = shares.iter_mut().min_by_key(|(cost_s, _)| *cost_s) {
            *cost_s += spec.cost_s(size);
            names.push(spec.name);
        }
    }
    shares.into_iter().map(|(_, names)| names).collect()
}

/// The units of one shard.
///
/// # Errors
/// More shards than units.
fn share(shard: Shard, items: &[&Item], size: Size) -> Result<Vec<&'static str>> {
    let units = units_of(items);
    ensure!(
        shard.of() <= units.len() as u64,
        "--shard {shard}: {} units are measured for these tables and figures, so at most so many parts",
        units.len()
    );
    let mut shares = shares(&units, shard.of(), size);
    Ok(shares.swap_remove(usize::try_from(shard.number() - 1)?))
}

impl PartOf {
    /// The part that this command measures.
    ///
    /// # Errors
    /// More shards than units; the program's file cannot be read.
    pub fn new(shard: Shard, items: &[&Item], setting: &Setting) -> Result<Self> {
        share(shard, items, setting.size)?;
        Ok(Self {
            shard,
            items: items.iter().map(|item| item.id.to_owned()).collect(),
            actor: setting.actor.clone(),
            detector: setting.detector.clone(),
            program: Program::this()?,
        })
    }

    /// K of N.
    pub fn shard(&self) -> Shard {
        self.shard
    }

    /// The units that it measures.
    ///
    /// # Errors
    /// Items that this program does not know, more shards than units.
    pub fn units(&self, size: Size) -> Result<Vec<&'static str>> {
        share(self.shard, &chosen(&self.items)?, size)
    }

    /// Whether a folder holds a part.
    pub fn is_in(folder: &Path) -> bool {
        folder.join(PART).exists()
    }

    /// Marks a folder as this part's, or finds it marked so.
    ///
    /// # Errors
    /// A folder that holds a whole run, or another part.
    pub fn claim(&self, folder: &Path) -> Result<()> {
        if !Self::is_in(folder) {
            ensure!(
                !folder.join("data").exists(),
                "{} holds what was measured without --shard; name another folder with --output",
                folder.display()
            );
            return output::write(&folder.join(PART), toml::to_string_pretty(self)?);
        }
        let other = Self::load(folder)?;
        let difference = match other.shard == self.shard {
            false => Some(format!("it is shard {}, this is {}", other.shard, self.shard)),
            true => other.difference(self),
        };
        match difference {
            Some(difference) => bail!(
                "{} holds another part: {difference}; name another folder with --output, or remove it",
                folder.display()
            ),
            None => Ok(()),
        }
    }

    fn load(folder: &Path) -> Result<Self> {
        let path = folder.join(PART);
        ensure!(
            path.exists(),
            "{} is no part: it was not measured with `vigil reproduce --shard`",
            folder.display()
        );
        let text = vigil_types::files::read_text(&path, SMALL_FILE)
            .with_context(|| format!("cannot read {}", path.display()))?;
        toml::from_str(&text).with_context(|| format!("{} is damaged", path.display()))
    }

    /// How the run of which another is a part differs from the run of which this is one, if it does.
    fn difference(&self, other: &Self) -> Option<String> {
        let told = |path: &Option<PathBuf>| path.as_ref().map_or("built in".into(), |p| p.display().to_string());
        let words = [
            ("--only", self.items.join(","), other.items.join(",")),
            ("--actor", told(&self.actor), told(&other.actor)),
            ("--detector", told(&self.detector), told(&other.detector)),
        ];
        let differs = words.into_iter().find(|(_, own, others)| own != others);
        differs
            .map(|(what, own, others)| format!("its {what} is {own}, the other's {others}"))
            .or_else(|| self.program.difference(&other.program))
    }

    fn setting(&self, made_by: &MadeBy) -> Result<Setting> {
        Ok(Setting {
            actor: self.actor.clone(),
            detector: self.detector.clone(),
            actor_sha256: made_by.actor_sha256.clone(),
            detector_sha256: made_by.detector_sha256.clone(),
            threads: None,
            size: match made_by.mode.as_str() {
                "quick" => Size::Quick,
                "full" => Size::Full,
                other => bail!("its mode is {other}, of which there are no parts"),
            },
            commit: made_by.commit.clone(),
        })
    }
}

/// All parts, checked: each unit of the run is there once and whole.
pub struct Joined {
    pub made_by: MadeBy,
    pub items: Vec<&'static Item>,
    /// Each unit, and where it lies.
    units: BTreeMap<&'static str, (Unit, Data)>,
}

/// Reads the parts, in any order; a part may come more than once, and parts may be of several divisions of the same run.
///
/// # Errors
/// Parts of another commit, mode, actor, detector, choice of items or program; damaged files; units that contradict each other or are
/// missing: which shards to measure.
pub fn join(folders: &[PathBuf]) -> Result<Joined> {
    let (first, _) = folders.split_first().context("name the parts")?;
    let (made_by, part) = (MadeBy::load(first)?, PartOf::load(first)?);
    ensure!(
        made_by.version == env!("CARGO_PKG_VERSION"),
        "{} is of version {}, and this program of {}: merge with the program that measured",
        first.display(),
        made_by.version,
        env!("CARGO_PKG_VERSION")
    );
    let setting = part.setting(&made_by).with_context(|| first.display().to_string())?;
    let items = chosen(&part.items)?;
    let mut units: BTreeMap<&'static str, (Unit, Data)> = BTreeMap::new();
    let mut shards = Vec::new();
    for folder in folders {
        let (other_made_by, other) = (MadeBy::load(folder)?, PartOf::load(folder)?);
        let differences = other_made_by.differences(&made_by, "the other's");
        let difference = match differences.is_empty() {
            false => Some(differences.join("; ")),
            true => other.difference(&part),
        };
        if let Some(difference) = difference {
            bail!(
                "{} and {} are parts of different runs: {difference}",
                folder.display(),
                first.display()
            );
        }
        let data = Data::fresh(&folder.join("data"))?;
        let own = other
            .units(setting.size)
            .with_context(|| format!("{} is damaged", folder.join(PART).display()))?;
        for name in data.names() {
            ensure!(
                own.contains(&name),
                "{} holds the unit {name}, which is not of shard {}",
                folder.display(),
                other.shard
            );
        }
        for spec in SPECS.iter().filter(|spec| own.contains(&spec.name)) {
            let Some(unit) = data.unit(spec.name) else { continue };
            data.check(spec.name, &spec.unit(&setting), spec.files)?;
            match units.get(spec.name) {
                Some((other, there)) => ensure!(
                    other == unit,
                    "{} and {} contradict each other: {} came out differently. Flights come out the same on every machine, times do \
                     not: leave one of the two out, or measure its shard again",
                    there.folder().display(),
                    data.folder().display(),
                    spec.name
                ),
                None => {
                    units.insert(spec.name, (unit.clone(), data.clone()));
                }
            }
        }
        shards.push(other.shard);
    }
    let missing: Vec<&str> = units_of(&items)
        .iter()
        .map(|spec| spec.name)
        .filter(|name| !units.contains_key(name))
        .collect();
    if !missing.is_empty() {
        bail!(missing_in_words(&missing, &shards, |shard| share(
            shard,
            &items,
            setting.size
        ))?);
    }
    Ok(Joined { made_by, items, units })
}

/// Which shards to measure.
fn missing_in_words(
    missing: &[&str],
    shards: &[Shard],
    share: impl Fn(Shard) -> Result<Vec<&'static str>>,
) -> Result<String> {
    let of = shards.first().map_or(1, |shard| shard.of());
    let mut wanted = Vec::new();
    for shard in Shard::all(of) {
        if share(shard)?.iter().any(|unit| missing.contains(unit)) {
            wanted.push(match shards.contains(&shard) {
                true => format!("{shard} (interrupted)"),
                false => shard.to_string(),
            });
        }
    }
    Ok(format!(
        "{} units are missing ({}): measure --shard {}",
        missing.len(),
        missing.join(", "),
        wanted.join(", ")
    ))
}

impl Joined {
    /// Copies the units into a folder as one run would have left them there; what is there already must be the same.
    ///
    /// # Errors
    /// A folder of something else or of a part, units there that are others or damaged, a folder that cannot be written.
    pub fn copy_to(&self, whole: &Path) -> Result<Data> {
        ensure!(
            !PartOf::is_in(whole),
            "{} is a part itself; name another folder with --output",
            whole.display()
        );
        let folder = whole.join("data");
        let there = Data::fresh(&folder)?;
        for (name, (unit, part)) in &self.units {
            if let Some(other) = there.unit(name) {
                ensure!(
                    other == unit,
                    "{} and {} contradict each other: {name} came out differently; name another folder with --output, or remove it",
                    part.folder().display(),
                    folder.display()
                );
            }
        }
        self.made_by.claim(whole)?;
        let mut data = there;
        for (name, (unit, part)) in &self.units {
            for file in unit.files.keys() {
                let to = folder.join(file);
                let inner = to.parent().unwrap_or(&folder);
                std::fs::create_dir_all(inner).with_context(|| format!("cannot make {}", inner.display()))?;
                output::write(&to, part.content(unit, file)?)?;
            }
            data.enter_whole(name, unit.clone())?;
        }
        Ok(data)
    }
}

#[cfg(test)]
mod tests {
    use super::super::units::measure;
    use super::super::{measure_part, measured_in};
    use super::*;
    use std::ffi::OsString;
    use std::fs;
    use std::process::ExitCode;

    /// Leaves the files of the unit that a command line belongs to, with its name as their content.
    fn stub(words: Vec<OsString>) -> Result<ExitCode> {
        let after = words.iter().skip_while(|word| *word != "-o").nth(1);
        let place = Path::new(after.context("no -o")?);
        let folder = match words[1] == "evaluate" {
            true => place.parent().context("no folder")?,
            false => place,
        };
        let name = folder.file_name().context("no name")?.to_string_lossy();
        let spec = SPECS.iter().find(|spec| spec.name == name).context("no unit")?;
        for file in spec.files {
            fs::write(folder.join(file), format!("{name} {file}"))?;
        }
        Ok(ExitCode::SUCCESS)
    }

    struct Run {
        folder: tempfile::TempDir,
        setting: Setting,
        made_by: MadeBy,
        items: Vec<&'static Item>,
        program: Program,
    }

    impl Run {
        fn new(only: &[&str]) -> Self {
            let setting = Setting::new(None, None, Some(1), Size::Quick).unwrap();
            let only: Vec<String> = only.iter().map(|name| (*name).to_owned()).collect();
            Self {
                folder: tempfile::tempdir().unwrap(),
                made_by: MadeBy {
                    version: env!("CARGO_PKG_VERSION").to_owned(),
                    commit: setting.commit.clone(),
                    mode: "quick".to_owned(),
                    actor_sha256: setting.actor_sha256.clone(),
                    detector_sha256: setting.detector_sha256.clone(),
                },
                setting,
                items: chosen(&only).unwrap(),
                program: Program::this().unwrap(),
            }
        }

        fn place(&self, name: &str) -> PathBuf {
            self.folder.path().join(name)
        }

        fn part(&self, shard: &str) -> PartOf {
            PartOf {
                shard: shard.parse().unwrap(),
                items: self.items.iter().map(|item| item.id.to_owned()).collect(),
                actor: None,
                detector: None,
                program: self.program.clone(),
            }
        }

        fn measure(&self, part: &PartOf, name: &str) -> PathBuf {
            let folder = self.place(name);
            self.made_by.claim(&folder).unwrap();
            measure_part(part, &folder, &self.setting, &stub).unwrap();
            folder
        }

        fn shard(&self, shard: &str, name: &str) -> PathBuf {
            self.measure(&self.part(shard), name)
        }
    }

    fn files(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
        let mut found = BTreeMap::new();
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                found.extend(files(&path).into_iter().map(|(name, content)| {
                    let inner = path.file_name().unwrap();
                    (Path::new(inner).join(name), content)
                }));
            } else {
                found.insert(path.file_name().unwrap().into(), fs::read(&path).unwrap());
            }
        }
        found
    }

    fn refused(parts: &[&PathBuf]) -> String {
        let parts: Vec<PathBuf> = parts.iter().map(|part| (*part).clone()).collect();
        format!("{:#}", join(&parts).err().expect("refused"))
    }

    #[test]
    fn each_unit_is_measured_by_one_shard_and_no_shard_could_give_one_away_to_lighten_the_load() {
        let items = chosen(&[]).unwrap();
        let units = units_of(&items);
        for size in [Size::Quick, Size::Full] {
            let cost_of = |name: &&str| units.iter().find(|spec| spec.name == *name).unwrap().cost_s(size);
            for of in 1..=units.len() as u64 {
                let shares = shares(&units, of, size);
                let mut all: Vec<&str> = shares.concat();
                all.sort_unstable();
                let mut expected: Vec<&str> = units.iter().map(|spec| spec.name).collect();
                expected.sort_unstable();
                assert_eq!(all, expected);
                let loads: Vec<u32> = shares.iter().map(|share| share.iter().map(cost_of).sum()).collect();
                let least = *loads.iter().min().unwrap();
                for (share, load) in shares.iter().zip(&loads) {
                    assert!(!share.is_empty(), "{of} shards");
                    // The last given is the cheapest of a share.
                    assert!(load - cost_of(share.last().unwrap()) <= least, "{of} shards: {loads:?}");
                }
            }
            let one_too_many: Shard = format!("1/{}", units.len() + 1).parse().unwrap();
            let told = share(one_too_many, &items, size).unwrap_err().to_string();
            assert!(told.contains("16 units are measured"), "{told}");
        }
    }

    #[test]
    fn parts_make_the_folder_of_one_run_byte_for_byte_in_any_order_and_again() {
        let run = Run::new(&[]);
        let one = run.place("one");
        run.made_by.claim(&one).unwrap();
        let names: Vec<&str> = units_of(&run.items).iter().map(|spec| spec.name).collect();
        measure(&names, &run.setting, &mut measured_in(&one).unwrap(), &stub).unwrap();
        let expected = files(&one);
        assert!(expected.len() > SPECS.len());

        let thirds = ["3/3", "1/3", "2/3"].map(|shard| run.shard(shard, &shard[..1]));
        let [third, first, second] = thirds.clone();
        // Halves measured one unit of the thirds' each again, with the same result.
        let half = run.shard("2/2", "half");
        for (name, parts) in [
            ("a", thirds.to_vec()),
            ("b", vec![first.clone(), half, second, third, first]),
        ] {
            let whole = run.place(name);
            for _ in 0..2 {
                join(&parts).unwrap().copy_to(&whole).unwrap();
                assert!(files(&whole) == expected, "{name} differs");
            }
        }
    }

    #[test]
    fn a_part_that_was_interrupted_is_gone_on_with_and_its_shard_is_asked_for_until_it_is_whole() {
        let run = Run::new(&["table-2", "figure-12", "figure-14"]);
        let first = run.shard("1/2", "first");
        assert!(
            refused(&[&first]).ends_with("measure --shard 2/2"),
            "{}",
            refused(&[&first])
        );

        let (part, folder) = (run.part("2/2"), run.place("second"));
        run.made_by.claim(&folder).unwrap();
        let failing = |_: Vec<OsString>| bail!("no disk");
        assert!(measure_part(&part, &folder, &run.setting, &failing).is_err());
        let told = refused(&[&first, &folder]);
        assert!(told.ends_with("measure --shard 2/2 (interrupted)"), "{told}");
        let second = run.measure(&part, "second");
        join(&[first, second]).unwrap().copy_to(&run.place("whole")).unwrap();
    }

    #[test]
    fn parts_of_another_run_are_refused_with_what_differs() {
        let run = Run::new(&["table-2", "figure-12"]);
        let first = run.shard("1/2", "first");
        let mut other = Run::new(&["table-2", "figure-12"]);
        other.made_by.commit = "another".to_owned();
        let told = refused(&[&first, &other.shard("2/2", "commit")]);
        assert!(told.contains("its commit is another, the other's"), "{told}");
        other.made_by = run.made_by.clone();
        other.made_by.mode = "full".to_owned();
        assert!(refused(&[&first, &other.shard("2/2", "mode")]).contains("its mode is full"));
        other.made_by = run.made_by.clone();
        other.made_by.actor_sha256 = "b".to_owned();
        assert!(refused(&[&first, &other.shard("2/2", "actor")]).contains("its actor is b"));

        let altered = |name: &str, alter: &dyn Fn(&mut PartOf)| {
            let mut part = run.part("2/2");
            alter(&mut part);
            refused(&[&first, &run.measure(&part, name)])
        };
        let told = altered("detector", &|part| part.detector = Some("mine".into()));
        assert!(told.contains("its --detector is mine, the other's built in"), "{told}");
        let told = altered("items", &|part| {
            part.items = vec!["figure-12".into(), "figure-14".into()]
        });
        assert!(told.contains("its --only is figure-12,figure-14"), "{told}");
        let sha256 = |part: &mut PartOf| {
            let text = toml::to_string(&part.program).unwrap();
            let digest = text.lines().find(|line| line.starts_with("sha256")).unwrap();
            part.program = toml::from_str(&text.replace(digest, "sha256 = \"another\"")).unwrap();
        };
        assert!(altered("program", &sha256).contains("SHA-256 another"));
    }

    #[test]
    fn what_is_damaged_or_contradicts_itself_is_refused_before_anything_is_written() {
        let run = Run::new(&["table-2", "figure-12"]);
        let (first, second) = (run.shard("1/2", "first"), run.shard("2/2", "second"));
        let again = run.shard("1/2", "again");
        let unit = run.part("1/2").units(Size::Quick).unwrap()[0];
        let spec = SPECS.iter().find(|spec| spec.name == unit).unwrap();
        let file = again.join("data").join(unit).join(spec.files[0]);
        let index = again.join("data/index.toml");
        let kept = fs::read_to_string(&index).unwrap();

        fs::write(&file, "other").unwrap();
        let told = refused(&[&first, &again, &second]);
        assert!(told.contains("is not what was measured"), "{told}");
        // Measured again, with another result.
        let mut data = Data::fresh(&again.join("data")).unwrap();
        data.enter(unit, spec.unit(&run.setting), spec.files).unwrap();
        let told = refused(&[&first, &again, &second]);
        assert!(
            told.contains(&format!("contradict each other: {unit} came out differently")),
            "{told}"
        );
        let whole = run.place("whole");
        join(&[again.clone(), second.clone()]).unwrap().copy_to(&whole).unwrap();
        let before = files(&whole);
        let told = join(&[first.clone(), second.clone()])
            .unwrap()
            .copy_to(&whole)
            .unwrap_err();
        assert!(told.to_string().contains("contradict each other"), "{told}");
        assert!(files(&whole) == before);

        fs::write(&index, kept.replace("vigil ", "vigil other ")).unwrap();
        assert!(refused(&[&again]).contains("index.toml is damaged"));
        fs::write(&index, "[units.").unwrap();
        assert!(refused(&[&again]).contains("index.toml is damaged"));
        fs::remove_file(&file).unwrap();
        fs::write(&index, kept).unwrap();
        assert!(refused(&[&again]).contains("cannot read"));
        fs::write(again.join(PART), "shard = \"1/").unwrap();
        assert!(refused(&[&again]).contains("part.toml is damaged"));
        fs::copy(second.join(PART), again.join(PART)).unwrap();
        assert!(refused(&[&again]).contains("which is not of shard 2/2"));
        fs::remove_file(again.join(PART)).unwrap();
        assert!(refused(&[&again]).contains("is no part"));

        let told = join(&[first.clone(), second.clone()])
            .unwrap()
            .copy_to(&first)
            .unwrap_err();
        assert!(told.to_string().contains("is a part itself"), "{told}");
        let told = run.part("2/2").claim(&first).unwrap_err().to_string();
        assert!(told.contains("it is shard 1/2, this is 2/2"), "{told}");
        let told = run.part("2/2").claim(&whole).unwrap_err().to_string();
        assert!(told.contains("without --shard"), "{told}");
    }
}
