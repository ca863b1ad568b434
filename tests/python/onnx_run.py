"""What ONNX Runtime makes of models that `vigil export` wrote: for each NAME.onnx of a folder its NAME.inputs.json, a list of lists of
numbers as they are in memory here, becomes NAME.outputs.json. Runs in the environment of requirements-onnx.txt."""

import json
import sys
from pathlib import Path

import numpy
import onnx
import onnxruntime


def as_input(info, values):
    shape = info.shape
    if info.name == "frame":
        batch, channels, rows, cols = shape
        return numpy.array(values, numpy.float32).reshape(batch, rows, cols, channels).transpose(0, 3, 1, 2)
    return numpy.array(values, numpy.float32).reshape(shape)


for path in sorted(Path(sys.argv[1]).glob("*.onnx")):
    model = onnx.load(path)
    onnx.checker.check_model(model, full_check=True)
    assert any(entry.key == "sha256" and len(entry.value) == 64 for entry in model.metadata_props)
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    given = json.loads(path.with_suffix(".inputs.json").read_text())
    inputs = session.get_inputs()
    assert len(given) == len(inputs), path
    feeds = {info.name: as_input(info, values) for info, values in zip(inputs, given)}
    [action] = session.run(["action"], feeds)
    path.with_suffix(".outputs.json").write_text(json.dumps(action.ravel().tolist()))
