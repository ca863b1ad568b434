//! tract's side of the comparison of one new frame through the actor (docs/peers.md).
//!
//! Reads an ONNX file and its inputs (raw float32, in the order of the model), prints `ready` and the first output's
//! values, then answers each line `RUNS` on standard input with the processor time of one run in nanoseconds, the mean
//! over RUNS. tools/peers/compare.py starts it.

use anyhow::{Context, Result, ensure};
use rustix::time::{ClockId, clock_gettime};
use std::io::{BufRead, Write};
use tract_onnx::prelude::*;

/// Processor time of this process, nanoseconds.
fn processor_ns() -> u64 {
    let now = clock_gettime(ClockId::ProcessCPUTime);
    now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64
}

fn main() -> Result<()> {
    let mut arguments = std::env::args_os().skip(1);
    let mut next = || arguments.next().context("expected MODEL.onnx INPUTS.bin");
    let (path, inputs) = (next()?, next()?);
    let model = tract_onnx::onnx().model_for_path(&path)?.into_optimized()?;
    let bytes = std::fs::read(&inputs).with_context(|| format!("cannot read {}", inputs.display()))?;
    let mut values = bytes
        .chunks_exact(4)
        .map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]));
    let mut feed = TVec::new();
    for i in 0..model.input_outlets()?.len() {
        let fact = model.input_fact(i)?;
        let shape = fact
            .shape
            .as_concrete()
            .context("the model's inputs have open dimensions")?;
        let len = shape.iter().product();
        let own: Vec<f32> = values.by_ref().take(len).collect();
        ensure!(own.len() == len, "{} is too short for the model", inputs.display());
        feed.push(Tensor::from_shape(shape, &own)?.into_tvalue());
    }
    ensure!(
        values.next().is_none(),
        "{} is too long for the model",
        inputs.display()
    );
    let mut state = model.into_runnable()?.spawn()?;
    let first = state.run(feed.clone())?;
    let mut out = std::io::stdout();
    write!(out, "ready")?;
    for value in first[0].to_plain_array_view::<f32>()? {
        write!(out, " {value}")?;
    }
    writeln!(out)?;
    out.flush()?;
    for line in std::io::stdin().lock().lines() {
        let line = line?;
        let runs: u32 = line
            .trim()
            .parse()
            .with_context(|| format!("`{line}` is not a number of runs"))?;
        let before = processor_ns();
        for _ in 0..runs {
            std::hint::black_box(state.run(feed.clone())?);
        }
        writeln!(out, "{}", (processor_ns() - before) as f64 / f64::from(runs.max(1)))?;
        out.flush()?;
    }
    Ok(())
}
