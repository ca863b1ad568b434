//! Disks without room: what flies flies on and says so, what only writes ends by name.

use crate::campaign::{Ending, Folder, Row, Trial};
use crate::flight::{Extras, Flight, Site};
use anyhow::Result;
use std::path::Path;
use std::process::{Command, Stdio};
use vigil_sim::world::Outcome;

/// A file system of a few megabytes in memory; unmounted at its end.
struct SmallDisk(tempfile::TempDir);

impl SmallDisk {
    /// `None` where mounting is not permitted.
    fn mount(size: &str) -> Option<Self> {
        let folder = tempfile::tempdir().ok()?;
        let mounted = Command::new("mount")
            .args(["-t", "tmpfs", "-o", &format!("size={size}"), "tmpfs"])
            .arg(folder.path())
            .stderr(Stdio::null())
            .status();
        mounted.is_ok_and(|status| status.success()).then_some(Self(folder))
    }

    fn path(&self) -> &Path {
        self.0.path()
    }

    fn fill(&self) {
        // Ends when nothing more fits, which is what it is for.
        let _ = std::fs::write(self.path().join("filler"), vec![0_u8; 64 << 20]);
    }
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg(self.path()).status();
    }
}

pub fn rows(site: &Site<'_>, _: &Folder) -> Result<Vec<Row>> {
    let mut rows = vec![refusals()];
    if !site.quick {
        rows.push(no_state(site));
        rows.push(flights(site)?);
    }
    Ok(rows)
}

/// A firmware that cannot keep its state must not begin: its counters against replayed packets would be lost.
fn no_state(site: &Site<'_>) -> Row {
    const NAME: &str = "no room for the state at the start";
    let Some(disk) = SmallDisk::mount("64k") else {
        return Row::of(NAME, &[], "left out: needs the right to mount");
    };
    disk.fill();
    let (instance, state) = (site.instances[0], disk.path().display());
    let output = vigil_tests::run_line(&format!("firmware --instance {instance} --state {state}"));
    let trial = match (output.status.code(), vigil_tests::said(&output)) {
        (Some(1), said) if said.contains("No space left") => Trial::right(Ending::Named),
        (_, said) => Trial::wrong(Ending::Crashed, said),
    };
    Row::of(NAME, &[trial], "refused by name")
}

/// Reports and files that cannot be written.
fn refusals() -> Row {
    let vigil = vigil_tests::vigil();
    let shell = |command: &str| {
        let mut shell = Command::new("bash");
        shell.args(["-c", &format!("{} {command}", vigil.display())]);
        shell.stdin(Stdio::null()).output()
    };
    let commands = [
        "evaluate --flights 1 --pilot geometric --json /dev/full",
        "evaluate --flights 1 --pilot geometric --json /dev/null > /dev/full",
        "courses write --seed 7 > /dev/full",
        "courses draw --seed 7 -o /dev/full/course.png",
        "detector figures --seed 7 --pictures 1 -o /dev/full/images",
        "fly --instance 0 -o /dev/full/runs",
        "attack deflection --states 1 -o /dev/full",
    ];
    let trials = commands.map(|command| {
        let wrong = |ending, what: &str| Trial::wrong(ending, format!("`vigil {command}`{what}"));
        match shell(command).map(|output| (output.status.code(), vigil_tests::said(&output))) {
            Ok((Some(0), _)) => wrong(Ending::Named, " is a success"),
            // A command that is none tries nothing.
            Ok((Some(2), said)) => wrong(Ending::Named, &format!(": {said}")),
            Ok((Some(101) | None, said)) => wrong(Ending::Crashed, &format!(": {said}")),
            Ok((_, said)) if said.trim().is_empty() => wrong(Ending::Named, " says nothing"),
            Ok(_) => Trial::right(Ending::Named),
            Err(error) => Trial::wrong(Ending::Crashed, error.to_string()),
        }
    });
    Row::of("nothing can be written", &trials, "exit code and words of each command")
}

/// Flights whose log and state go to a disk that fills up.
fn flights(site: &Site<'_>) -> Result<Row> {
    const NAME: &str = "disk full in flight";
    let mut trials = Vec::new();
    for number in 0..4 {
        let (Some(logs), Some(state)) = (SmallDisk::mount("8m"), SmallDisk::mount("256k")) else {
            return Ok(Row::of(NAME, &[], "left out: needs the right to mount"));
        };
        let to = state.path().display();
        let extras = Extras {
            firmware: format!("--log {}/{number} --state {to}", logs.path().display()),
            simulator: format!("--state {to}"),
            ..Extras::default()
        };
        let work = tempfile::tempdir()?;
        let mut flight = Flight::start(site.instances[0], site.seed + number, work.path(), extras)?;
        let flown = flight.take_off(site.stop).and_then(|()| {
            state.fill();
            flight.fly_to_its_end(site.stop)
        });
        let fallen = flight.fallen();
        let arrived = flight.outcome() == Some(Outcome::Success);
        let names = |line: &String| line.starts_with("log") && line.contains("space");
        trials.push(match (flown, flight.end_firmware()) {
            _ if !fallen.is_empty() => Trial::wrong(Ending::Crashed, format!("{} ended", fallen.join(", "))),
            (Err(error), _) | (_, Err(error)) => Trial::wrong(Ending::TimeOut, format!("{error:#}")),
            _ if !arrived => Trial::wrong(Ending::TimeOut, "it does not arrive"),
            (Ok(_), Ok(said)) if !said.iter().any(names) => {
                let said = said.join(" | ");
                Trial::wrong(Ending::Arrived, format!("the full disk is not named: {said}"))
            }
            _ => Trial::right(Ending::Arrived),
        });
    }
    Ok(Row::of(
        NAME,
        &trials,
        "room for 8 MB of log, none for state after take-off; the summary names the disk",
    ))
}
