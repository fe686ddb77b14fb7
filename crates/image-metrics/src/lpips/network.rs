//! A network with its weights: features of a picture, and their gradient by it.

use super::architecture::{ConvolutionPlan, LayerPlan, StepPlan};
use super::convolution::Convolution;
use super::maps::Maps;
use super::pool::Pool;

#[derive(Debug)]
enum Layer {
    Convolution(Convolution),
    Fire(Box<Fire>),
    Pool(Pool),
}

#[derive(Debug)]
struct Fire {
    squeeze: Convolution,
    expand: [Convolution; 2],
}

#[derive(Debug)]
pub(super) struct Network {
    /// Layers, and whether their output is compared.
    steps: Vec<(Layer, bool)>,
}

/// What a layer computed.
pub(super) struct Record {
    output: Maps,
    /// Of a fire layer.
    squeezed: Option<Maps>,
    /// Of a pool.
    places: Vec<u8>,
}

impl Network {
    /// From a plan, and what makes its convolutions.
    pub(super) fn new<E>(
        plan: &[StepPlan],
        mut convolution: impl FnMut(&ConvolutionPlan) -> Result<Convolution, E>,
    ) -> Result<Self, E> {
        let mut layer = |plan: &LayerPlan| {
            Ok(match plan {
                LayerPlan::Convolution(plan) => Layer::Convolution(convolution(plan)?),
                LayerPlan::Fire { squeeze, expand: [one, three] } => Layer::Fire(Box::new(Fire {
                    squeeze: convolution(squeeze)?,
                    expand: [convolution(one)?, convolution(three)?],
                })),
                LayerPlan::Pool(pool) => Layer::Pool(*pool),
            })
        };
        let steps =
            plan.iter().map(|(plan, is_tap)| Ok((layer(plan)?, *is_tap))).collect::<Result<_, E>>()?;
        Ok(Self { steps })
    }

    /// The shortest side of a picture that leaves something for every layer.
    pub(super) fn minimum(&self) -> usize {
        let fits = |&n: &usize| {
            let step = |n: usize, (layer, _): &(Layer, bool)| Some(layer.size(n, n)?.0);
            self.steps.iter().try_fold(n, step).is_some_and(|n| n > 0)
        };
        (1..).find(fits).expect("some size fits every network")
    }

    /// Runs all layers. Records whose outputs are not compared are emptied unless `keep` says otherwise.
    pub(super) fn run(&self, picture: &Maps, keep: bool) -> Vec<Record> {
        let mut records: Vec<Record> = Vec::with_capacity(self.steps.len());
        for (step, (layer, _)) in self.steps.iter().enumerate() {
            let record = layer.run(records.last().map_or(picture, |record| &record.output));
            if !keep && step > 0 && !self.steps[step - 1].1 {
                records.pop();
                records.push(Record { output: Maps::zeros(0, 0, 0), squeezed: None, places: Vec::new() });
            }
            records.push(record);
        }
        records
    }

    /// The outputs that are compared.
    pub(super) fn taps<'a>(&self, records: &'a [Record]) -> impl Iterator<Item = &'a Maps> {
        let steps = self.steps.iter().map(|(_, is_tap)| *is_tap).collect::<Vec<_>>();
        records.iter().zip(steps).filter(|(_, is_tap)| *is_tap).map(|(record, _)| &record.output)
    }

    /// The gradient by the picture, from that by every output that is compared.
    pub(super) fn pull_back(&self, picture: &Maps, records: &[Record], mut taps: Vec<Vec<f32>>) -> Maps {
        let mut gradient: Option<Maps> = None;
        for (i, ((layer, is_tap), record)) in self.steps.iter().zip(records).enumerate().rev() {
            if *is_tap {
                let tap = taps.pop().expect("as many gradients as taps");
                match &mut gradient {
                    Some(gradient) => gradient.add(&tap),
                    none => *none = Some(Maps { values: tap, ..record.output.like() }),
                }
            }
            let input = if i > 0 { &records[i - 1].output } else { picture };
            gradient = gradient.map(|gradient| layer.pull_back(gradient, record, input));
        }
        gradient.expect("the last layer is compared")
    }
}

impl Layer {
    fn size(&self, height: usize, width: usize) -> Option<(usize, usize)> {
        match self {
            Self::Convolution(layer) => layer.size(height, width),
            Self::Fire(_) => Some((height, width)),
            Self::Pool(pool) => Some((pool.steps(height)?, pool.steps(width)?)),
        }
    }

    fn run(&self, x: &Maps) -> Record {
        let (height, width) = self.size(x.height, x.width).expect("the size was checked");
        match self {
            Self::Convolution(layer) => {
                let mut output = Maps::zeros(height, width, layer.outputs());
                layer.apply(x.view(), &mut output, 0);
                Record { output, squeezed: None, places: Vec::new() }
            }
            Self::Fire(fire) => {
                let Fire { squeeze, expand: [one, three] } = &**fire;
                let mut squeezed = Maps::zeros(height, width, squeeze.outputs());
                squeeze.apply(x.view(), &mut squeezed, 0);
                let mut output = Maps::zeros(height, width, one.outputs() + three.outputs());
                one.apply(squeezed.view(), &mut output, 0);
                three.apply(squeezed.view(), &mut output, one.outputs());
                Record { output, squeezed: Some(squeezed), places: Vec::new() }
            }
            Self::Pool(pool) => {
                let (output, places) = pool.apply(x, height, width);
                Record { output, squeezed: None, places }
            }
        }
    }

    fn pull_back(&self, mut gradient: Maps, record: &Record, input: &Maps) -> Maps {
        let (height, width) = (input.height, input.width);
        match self {
            Self::Convolution(layer) => {
                gradient.mask(&record.output);
                layer.pull_back(gradient.view(), height, width)
            }
            Self::Fire(fire) => {
                let Fire { squeeze, expand: [one, three] } = &**fire;
                gradient.mask(&record.output);
                let squeezed = record.squeezed.as_ref().expect("fire layers record it");
                let mut sum = one.pull_back(gradient.part(0, one.outputs()), height, width);
                let rest = gradient.part(one.outputs(), three.outputs());
                sum.add(&three.pull_back(rest, height, width).values);
                sum.mask(squeezed);
                squeeze.pull_back(sum.view(), height, width)
            }
            Self::Pool(pool) => pool.pull_back(&gradient, &record.places, height, width),
        }
    }
}
