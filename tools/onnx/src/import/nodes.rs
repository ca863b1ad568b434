//! The operator of each node: a constant, or the layers that compute it.

use super::importer::{Importer, Live, NOT_FINITE, Value, shape_of};
use super::places::expanded;
use crate::constant::{Constant, Data, len_of};
use crate::fold::{self, Reduction};
use crate::proto::Node;
use std::collections::HashSet;
use std::rc::Rc;
use vigil_nnet::{Activation, Function};

/// The operators that are known, for the message about others.
const KNOWN: &str = "Abs, Add, AveragePool, BatchNormalization, Cast, Celu, Clip, Concat, Constant, Conv, Div, Dropout, Elu, Erf, \
    Exp, Expand, Flatten, GRU, Gather, Gelu, Gemm, GlobalAveragePool, GlobalMaxPool, HardSigmoid, HardSwish, Identity, LSTM, LayerNormalization, \
    LeakyRelu, Log, MatMul, Max, MaxPool, Min, Mish, Mul, Neg, PRelu, Pow, Reciprocal, ReduceMax, ReduceMean, ReduceSum, Relu, Reshape, Selu, \
    Shape, Sigmoid, Slice, Softplus, Softsign, Split, Sqrt, Squeeze, Sub, Sum, Swish, Tanh, Transpose, Unsqueeze";

impl<'a> Importer<'a> {
    pub(super) fn node(&mut self, node: &'a Node) -> Result<(), String> {
        let unknown = || format!("this operator is not supported; there are {KNOWN}");
        if !(node.domain.is_empty() || node.domain == "ai.onnx") {
            return Err(format!(
                "operators of `{}` are not supported; if a runtime optimised the model, import it from before",
                node.domain
            ));
        }
        let is_in = |names: &HashSet<&str>| node.output.first().is_some_and(|name| names.contains(name.as_str()));
        if is_in(&self.needed.pieces) {
            let (_, softplus) = self.input(node, 2)?;
            return self.set(node, 0, softplus);
        }
        if let Some(constant) = self.folded(node)? {
            return self.set(node, 0, Value::Constant(Rc::new(constant)));
        }
        let result = match node.op_type.as_str() {
            "GRU" | "LSTM" => return self.recurrent(node),
            "Split" => return self.split(node),
            "Concat" => self.concat(node)?,
            "Max" | "Min" | "Sum" => self.of_several(node)?,
            "Constant" => {
                let is_bound = is_in(&self.bounds);
                Value::Constant(Rc::new(stated(node)?.checked(is_bound)?))
            }
            "Shape" => {
                let (_, value) = self.input(node, 0)?;
                let sizes = stated_sizes(shape_of(&value), node);
                Value::Constant(Rc::new(Constant::row(Data::Whole(sizes))))
            }
            "Identity" | "Dropout" | "Cast" | "Reshape" | "Flatten" | "Squeeze" | "Unsqueeze" | "Transpose"
            | "Slice" | "Gather" | "Expand" => self.movement(node)?,
            _ => Value::Live(self.layer(node)?.ok_or_else(unknown)?),
        };
        self.set(node, 0, result)
    }

    /// The layers of a node that computes; `None` for an operator that is not known.
    fn layer(&mut self, node: &Node) -> Result<Option<Live>, String> {
        let alpha = |usual: f32| node.real("alpha", usual);
        let result = match node.op_type.as_str() {
            "Relu" => self.curve(node, Activation::Relu),
            "Tanh" => self.curve(node, Activation::TANH),
            "Sigmoid" => self.curve(node, Activation::Sigmoid),
            "Elu" if alpha(1.0) == 1.0 => self.curve(node, Activation::Elu),
            "Elu" => self.function(node, Function::Elu { alpha: alpha(1.0) }),
            "LeakyRelu" => self.function(node, Function::LeakyRelu { alpha: alpha(0.01) }),
            "Softplus" => self.function(node, Function::Softplus),
            "Exp" => self.function(node, Function::Exp),
            "Log" => self.function(node, Function::Log),
            "Abs" => self.function(node, Function::Abs),
            "Erf" => self.function(node, Function::Erf),
            "Sqrt" => self.function(node, Function::Power { exponent: 0.5 }),
            "Reciprocal" => self.function(node, Function::Power { exponent: -1.0 }),
            "Neg" => {
                let x = self.live(node, 0)?;
                self.moved_by(&x, -1.0, 0.0)
            }
            "Clip" => self.clip(node),
            "Pow" => self.power(node),
            "Selu" | "Celu" | "PRelu" | "Softsign" | "HardSigmoid" | "HardSwish" | "Mish" | "Gelu" | "Swish" => {
                self.composed(node)
            }
            "LayerNormalization" => self.layer_norm(node),
            "ReduceMean" | "ReduceSum" | "GlobalAveragePool" => self.reduce(node),
            "Gemm" => self.gemm(node),
            "MatMul" => self.mat_mul(node),
            "Conv" => self.conv(node),
            "MaxPool" | "GlobalMaxPool" => self.max_pool(node),
            "ReduceMax" => self.reduce_max(node),
            "AveragePool" => self.average_pool(node),
            "BatchNormalization" => self.batch_norm(node),
            "Add" | "Sub" | "Mul" | "Div" => self.affine(node),
            _ => return Ok(None),
        };
        result.map(Some)
    }

    /// The constant that a node is whose inputs are all constants, if it is one that is known.
    fn folded(&self, node: &Node) -> Result<Option<Constant>, String> {
        let operator = node.op_type.as_str();
        let mut given = Vec::new();
        for (i, _) in node.input.iter().enumerate().filter(|(_, name)| !name.is_empty()) {
            match self.input(node, i)?.1 {
                Value::Constant(constant) => given.push(constant),
                Value::Live(_) => return Ok(None),
            }
        }
        let Some(first) = given.first() else {
            return Ok(None);
        };
        let made = match operator {
            "Clip" if node.input.get(1).is_none_or(String::is_empty) && given.len() == 2 => fold::fold("Min", &given)?,
            "Reshape" | "Flatten" | "Squeeze" | "Unsqueeze" | "Transpose" | "Slice" | "Gather" | "Identity"
            | "Dropout" | "Concat" | "Split" | "Shape" => return Ok(None),
            "Cast" => return first.cast(node.whole("to", 1)).map(Some),
            "ConstantOfShape" => {
                let shape: Option<Vec<usize>> = first.whole()?.iter().map(|size| usize::try_from(*size).ok()).collect();
                let shape = shape.ok_or("a shape with a negative size")?;
                let value = match node.get("value").and_then(|attribute| attribute.t.as_ref()) {
                    Some(tensor) => Constant::of(tensor)?.checked(false)?,
                    None => Constant::one(Data::Real(vec![0.0])),
                };
                if value.len() != 1 {
                    return Err("its value is not one number".to_owned());
                }
                let places = vec![0; len_of(&shape)?];
                return value.moved(shape, &places).map(Some);
            }
            "Expand" => {
                let wanted = given.get(1).ok_or("it has no shape")?;
                let (shape, places) = expanded(&first.shape, wanted)?;
                return first.moved(shape, &places).map(Some);
            }
            "ReduceMean" | "ReduceSum" | "ReduceProd" | "ReduceMax" | "ReduceMin" => {
                let (along, shape) = self.reduction(node, &first.shape)?;
                Some(fold::reduce(operator, first, &along, shape)?)
            }
            _ => fold::fold(operator, &given)?,
        };
        let finite = made.map(|constant| constant.checked(false)).transpose();
        finite.map_err(|_| NOT_FINITE.to_owned())
    }

    pub(super) fn reduction(&self, node: &Node, shape: &[usize]) -> Result<Reduction, String> {
        let axes = self.list(node, "axes", 1)?;
        let [keep, noop] =
            [("keepdims", 1), ("noop_with_empty_axes", 0)].map(|(name, usual)| node.whole(name, usual) != 0);
        fold::reduced(shape, axes.as_deref(), keep, noop)
    }

    pub(super) fn set(&mut self, node: &'a Node, i: usize, value: Value) -> Result<(), String> {
        let name = node.output.get(i).ok_or("it has no output")?;
        if self.tensors.insert(name, value).is_some() {
            return Err(format!("its output `{name}` is computed twice"));
        }
        Ok(())
    }
}

/// What a node `Shape` gives: the sizes of the axes from `start` to before `end`.
fn stated_sizes(shape: &[usize], node: &Node) -> Vec<i64> {
    let rank = shape.len() as i64;
    let place = |value: i64| if value < 0 { value.saturating_add(rank) } else { value }.clamp(0, rank) as usize;
    let (start, end) = (place(node.whole("start", 0)), place(node.whole("end", rank)));
    let sizes = shape.get(start..end).unwrap_or_default();
    sizes.iter().map(|size| *size as i64).collect()
}

/// What a node `Constant` states.
fn stated(node: &Node) -> Result<Constant, String> {
    let given = |name: &str| node.get(name);
    if let Some(tensor) = given("value").and_then(|attribute| attribute.t.as_ref()) {
        Constant::of(tensor)
    } else if let Some(list) = given("value_ints") {
        Ok(Constant::row(Data::Whole(list.ints.clone())))
    } else if let Some(list) = given("value_floats") {
        Ok(Constant::row(Data::Real(list.floats.clone())))
    } else if let Some(one) = given("value_int") {
        Ok(Constant::one(Data::Whole(vec![one.i])))
    } else if let Some(one) = given("value_float") {
        Ok(Constant::one(Data::Real(vec![one.f])))
    } else {
        Err("it holds no tensor of numbers".to_owned())
    }
}
