//! Operators that only move values: which value of a layer stands where.

use super::importer::{Importer, Live, Value, positive, shape_of};
use crate::constant::{Constant, len_of};
use crate::fold;
use crate::movement::{Moved, axis, reshape, take, transpose};
use crate::proto::Node;
use std::rc::Rc;
use vigil_nnet::{Activation, Dense};
use vigil_policy::imported::Layer;

/// Weights of a layer that only puts values in their order, at most.
const MOST_REARRANGED: usize = 1 << 22;

impl<'a> Importer<'a> {
    /// A part of a layer that is one run of it, as a layer of its own; others as they are.
    pub(super) fn narrowed(&mut self, live: &Live) -> Result<Live, String> {
        let (Some(least), Some(most)) = (live.places.iter().min(), live.places.iter().max()) else {
            return Err("it has no values".to_owned());
        };
        let (from, len) = (*least as usize, (most - least) as usize + 1);
        let own = self.lens.get(live.layer).copied().unwrap_or(0);
        if len == own || len > live.places.len() {
            return Ok(live.clone());
        }
        let x = live.layer;
        let layer = self.push(Layer::Slice { x, from, len }, Vec::new(), len)?;
        let places = live.places.iter().map(|place| place - least).collect();
        Ok(Live::of(layer, live.shape.clone(), Rc::new(places)))
    }

    /// A layer of the values, each at the place that `order` has for it; `order` has each place once.
    pub(super) fn arranged_as(&mut self, x: &Live, order: &[u32]) -> Result<usize, String> {
        let x = self.narrowed(x)?;
        let (own, n) = (self.lens.get(x.layer).copied().unwrap_or(0), x.places.len());
        if own == n && *x.places == order {
            return Ok(x.layer);
        }
        if own.saturating_mul(n) > MOST_REARRANGED {
            return Err(format!(
                "{n} of a layer's {own} values, put in another order before, are met by others: {own} × {n} is more than \
                 {MOST_REARRANGED}"
            ));
        }
        let mut params = vec![0.0; (own + 1) * n];
        for (place, to) in x.places.iter().zip(order) {
            params[*place as usize * n + *to as usize] = 1.0;
        }
        let layer = Layer::Dense {
            x: x.layer,
            layer: Dense::new(own, n),
            curve: Activation::Identity,
        };
        self.push(layer, params, n)
    }

    /// Whether the values are all those of a layer, each once, as an image's are.
    pub(super) fn is_whole(&self, x: &Live) -> bool {
        let n = x.places.len();
        let mut seen = vec![false; n];
        let each_once = x.places.iter().all(|place| {
            let slot = seen.get_mut(*place as usize);
            slot.is_some_and(|slot| !std::mem::replace(slot, true))
        });
        each_once && self.lens.get(x.layer) == Some(&n)
    }

    /// The result of an operator that only moves values.
    pub(super) fn moved(&self, node: &Node, value: &Value, (shape, places): Moved) -> Result<Value, String> {
        match value {
            Value::Constant(constant) => Ok(Value::Constant(Rc::new(constant.moved(shape, &places)?))),
            Value::Live(_) => self.live(node, 0)?.moved(shape, &places).map(Value::Live),
        }
    }

    /// A list of a node, which is a setting or its input `i`.
    pub(super) fn list(&self, node: &Node, name: &str, i: usize) -> Result<Option<Vec<i64>>, String> {
        match node.list(name) {
            Some(list) => Ok(Some(list.to_vec())),
            None => match self.optional(node, i)? {
                Some(constant) => Ok(Some(constant.whole()?.to_vec())),
                None => Ok(None),
            },
        }
    }

    pub(super) fn movement(&mut self, node: &Node) -> Result<Value, String> {
        let (_, value) = self.input(node, 0)?;
        let shape = shape_of(&value).to_vec();
        let len = len_of(&shape)?;
        let rank = shape.len();
        let axes_of =
            |axes: &[i64], rank: usize| -> Result<Vec<usize>, String> { axes.iter().map(|a| axis(*a, rank)).collect() };
        let in_place = |shape: Vec<usize>| (shape, (0..len).collect::<Vec<usize>>());
        let moved = match node.op_type.as_str() {
            "Cast" if matches!(value, Value::Live(_)) && !matches!(node.whole("to", 1), 1 | 11) => {
                return Err("values as whole numbers are not supported".to_owned());
            }
            "Identity" | "Dropout" | "Cast" => in_place(shape),
            "Reshape" => {
                let wanted = self.list(node, "shape", 1)?.ok_or("it has no shape")?;
                in_place(reshape(&shape, &wanted)?)
            }
            "Flatten" => {
                let at = match node.whole("axis", 1) {
                    end if end == rank as i64 => rank,
                    other => axis(other, rank)?,
                };
                in_place(vec![len_of(&shape[..at])?, len_of(&shape[at..])?])
            }
            "Squeeze" => {
                let dropped = match self.list(node, "axes", 1)? {
                    Some(axes) => axes_of(&axes, rank)?,
                    None => (0..rank).filter(|i| shape[*i] == 1).collect(),
                };
                if let Some(wrong) = dropped.iter().find(|i| shape[**i] != 1) {
                    return Err(format!("axis {wrong} of the shape {shape:?} is not 1"));
                }
                in_place((0..rank).filter(|i| !dropped.contains(i)).map(|i| shape[i]).collect())
            }
            "Unsqueeze" => {
                let axes = self.list(node, "axes", 1)?.ok_or("it has no axes")?;
                if axes.len() > 8 {
                    return Err(format!("{} axes", axes.len()));
                }
                let added = axes_of(&axes, rank + axes.len())?;
                let mut left = shape.iter();
                let sizes = (0..rank + axes.len()).map(|i| match added.contains(&i) {
                    true => Ok(1),
                    false => left.next().copied().ok_or_else(|| format!("axes {axes:?}")),
                });
                in_place(sizes.collect::<Result<_, _>>()?)
            }
            "Transpose" => {
                let order: Vec<usize> = match node.list("perm") {
                    Some(order) => axes_of(order, rank)?,
                    None => (0..rank).rev().collect(),
                };
                transpose(&shape, &order)?
            }
            "Expand" => expanded(&shape, self.constant(node, 1)?.as_ref())?,
            "Gather" => {
                let along = axis(node.whole("axis", 0), rank)?;
                let indices = self.constant(node, 1)?;
                let taken: Vec<usize> = indices
                    .whole()?
                    .iter()
                    .map(|i| axis(*i, shape[along]))
                    .collect::<Result<_, _>>()?;
                let (mut result, places) = take(&shape, along, &taken)?;
                match indices.shape.len() {
                    0 => drop(result.remove(along)),
                    1 => {}
                    _ => return Err("indices of more than one axis are not supported".to_owned()),
                }
                (result, places)
            }
            _ => self.slice(node, &shape)?,
        };
        self.moved(node, &value, moved)
    }

    fn slice(&self, node: &Node, shape: &[usize]) -> Result<Moved, String> {
        let starts = self.list(node, "starts", 1)?.ok_or("it has no starts")?;
        let ends = self.list(node, "ends", 2)?.ok_or("it has no ends")?;
        let axes = self.list(node, "axes", 3)?;
        let axes = axes.unwrap_or_else(|| (0..starts.len() as i64).collect());
        let steps = self.list(node, "steps", 4)?;
        let steps = steps.unwrap_or_else(|| vec![1; starts.len()]);
        if [ends.len(), axes.len(), steps.len()] != [starts.len(); 3] {
            return Err("starts, ends, axes and steps are not of one length".to_owned());
        }
        let mut moved: Moved = (shape.to_vec(), (0..len_of(shape)?).collect());
        for (((start, end), along), step) in starts.iter().zip(&ends).zip(&axes).zip(&steps) {
            let along = axis(*along, shape.len())?;
            let size = moved.0[along] as i64;
            // Backwards it ends before the first.
            let (first, last) = if *step < 0 { (-1, size - 1) } else { (0, size) };
            let place = |value: i64| if value < 0 { value.saturating_add(size) } else { value }.clamp(first, last);
            let stride = positive(step.saturating_abs(), "a step")?;
            let (from, to) = (place(*start), place(*end));
            let taken: Vec<usize> = match *step < 0 {
                true => (to + 1..=from).rev().step_by(stride).map(|i| i as usize).collect(),
                false => (from..to).step_by(stride).map(|i| i as usize).collect(),
            };
            if taken.is_empty() {
                return Err(format!("nothing is left of axis {along}"));
            }
            let (shape, places) = take(&moved.0, along, &taken)?;
            moved = (shape, places.into_iter().map(|place| moved.1[place]).collect());
        }
        Ok(moved)
    }

    pub(super) fn split(&mut self, node: &'a Node) -> Result<(), String> {
        let (_, value) = self.input(node, 0)?;
        let shape = shape_of(&value).to_vec();
        let along = axis(node.whole("axis", 0), shape.len())?;
        let count = node.output.len().max(1);
        let lens: Vec<usize> = match self.list(node, "split", 1)? {
            Some(lens) => lens
                .iter()
                .map(|len| positive(*len, "a part"))
                .collect::<Result<_, _>>()?,
            None => {
                let each = shape[along].div_ceil(count);
                (0..count)
                    .map(|i| each.min(shape[along].saturating_sub(i * each)))
                    .collect()
            }
        };
        if total(&lens) != Some(shape[along]) || lens.len() != count || lens.contains(&0) {
            return Err(format!("parts of {lens:?} of an axis of {}", shape[along]));
        }
        let mut from = 0;
        for (i, len) in lens.into_iter().enumerate() {
            let taken: Vec<usize> = (from..from + len).collect();
            let part = self.moved(node, &value, take(&shape, along, &taken)?)?;
            self.set(node, i, part)?;
            from += len;
        }
        Ok(())
    }

    pub(super) fn concat(&mut self, node: &Node) -> Result<Value, String> {
        let values: Vec<Value> = (0..node.input.len())
            .map(|i| self.input(node, i).map(|(_, value)| value))
            .collect::<Result<_, _>>()?;
        let shapes: Vec<&[usize]> = values.iter().map(shape_of).collect();
        let first = *shapes.first().ok_or("it has no inputs")?;
        let along = axis(node.whole("axis", 0), first.len())?;
        let others = |shape: &[usize]| -> Vec<usize> {
            let kept = shape.iter().enumerate().filter(|(i, _)| *i != along);
            kept.map(|(_, size)| *size).collect()
        };
        if let Some(wrong) = shapes
            .iter()
            .find(|s| s.len() != first.len() || others(s) != others(first))
        {
            return Err(format!("the shapes {first:?} and {wrong:?} along axis {along}"));
        }
        let mut shape = first.to_vec();
        let lens: Vec<usize> = shapes.iter().map(|shape| shape[along]).collect();
        shape[along] = total(&lens).ok_or_else(|| format!("shapes of {lens:?} along axis {along}"))?;
        let count = len_of(&shape)?;
        let (outer, inner) = (len_of(&shape[..along])?, len_of(&shape[along + 1..])?);
        // Where each value of the result is: in which input, and where there.
        let mut places = Vec::with_capacity(count);
        for o in 0..outer {
            for (input, own) in shapes.iter().enumerate() {
                let run = own[along] * inner;
                places.extend((o * run..(o + 1) * run).map(|place| (input, place)));
            }
        }
        let (mut constants, mut parts, mut begins, mut len) = (Vec::new(), Vec::new(), Vec::new(), 0usize);
        for value in &values {
            match value {
                Value::Constant(constant) => constants.push(constant.as_ref()),
                Value::Live(live) => {
                    let part = self.narrowed(live)?;
                    begins.push(len);
                    len += self.lens.get(part.layer).copied().unwrap_or(0);
                    parts.push(part);
                }
            }
        }
        if parts.is_empty() {
            let data = Constant::picked(&constants, &places)?;
            return Ok(Value::Constant(Rc::new(Constant { shape, data })));
        } else if !constants.is_empty() {
            return Err("constants beside values are not supported".to_owned());
        }
        let places = places
            .into_iter()
            .map(|(input, place)| (begins[input] + parts[input].places[place] as usize) as u32)
            .collect();
        let parts = parts.iter().map(|part| part.layer).collect();
        let layer = self.push(Layer::Concat { parts }, Vec::new(), len)?;
        Ok(Value::Live(Live::of(layer, shape, Rc::new(places))))
    }
}

/// The movement of values of `shape` to the shape that both they and `wanted` are spread to.
pub(super) fn expanded(shape: &[usize], wanted: &Constant) -> Result<Moved, String> {
    let wanted: Option<Vec<usize>> = wanted.whole()?.iter().map(|size| usize::try_from(*size).ok()).collect();
    let wanted = fold::broadcast_shape(shape, &wanted.ok_or("a shape with a negative size")?)?;
    let places = fold::spread_places(shape, &wanted)?;
    Ok((wanted, places))
}

/// A sum that may be beyond all numbers.
fn total(lens: &[usize]) -> Option<usize> {
    lens.iter().try_fold(0usize, |sum, len| sum.checked_add(*len))
}
