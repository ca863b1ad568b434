//! tract's side of the comparison of one new frame through the actor (docs/peers.md).
//!
//! Reads an ONNX file and its inputs (raw float32, in the order of the model), prints `ready` and the first output's
//! values, then answers each line `RUNS` on standard input with the processor time of one run in nanoseconds, the mean
//! over RUNS. tools/peers/compare.py starts it.

#[path = "../../src/timing.rs"]
mod timing;

use anyhow::{Context, Result, ensure};
use tract_onnx::prelude::*;

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
    let mut ready = "ready".to_owned();
    for value in first[0].to_plain_array_view::<f32>()? {
        ready += &format!(" {value}");
    }
    timing::answer(&ready, |runs| {
        timing::mean_ns(runs, || {
            std::hint::black_box(state.run(feed.clone())?);
            Ok(())
        })
    })
}
