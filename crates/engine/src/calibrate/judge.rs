//! Which law a follower keeps: how likely each makes what was measured, and the parameter that fits
//! best.

use isocat_esc::DriftLaw;
use isocat_sim::random::Stream;

use super::course::Course;
use super::likelihood::Prediction;
use super::replay::{Known, predict, reading_variances, shown};

/// How well one law fits.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Fit {
    /// The law, with the parameter that fits best.
    pub law: DriftLaw,
    /// Root mean square of measured less predicted, in standard deviations.
    pub misfit: f64,
    /// Minus twice the logarithm of the likelihood, but for a constant: the sum of those squares, and
    /// what a law that predicts less sharply is held to account for.
    pub unlikely: f64,
    /// The parameter as a real number, and its standard error: the phase, or the gain of
    /// `proportional`. `None` if the law does not fit, or beyond what is tried.
    pub parameter: Option<(f64, f64)>,
}

/// What was found out about a follower's law.
#[derive(Clone, PartialEq, Debug)]
pub enum Verdict {
    /// One law fits, and the others do not.
    Told(Fit),
    /// Several fit: the measurement can't tell them apart.
    NotToldApart(Vec<Fit>),
    /// None of them fits.
    NoneFits,
}

/// A follower's law by its courses.
#[derive(Clone, PartialEq, Debug)]
pub struct Judgement {
    /// What it is.
    pub verdict: Verdict,
    /// The best of each family, best first.
    pub fits: Vec<Fit>,
    /// Numbers compared.
    pub numbers: usize,
}

/// Compares what the courses show with what each law would have shown.
pub(super) fn judge(courses: &[Course], known: &[Known]) -> Judgement {
    let mut fits: Vec<Fit> = FAMILIES.iter().map(|family| best(courses, known, family)).collect();
    fits.sort_by(|a, b| a.unlikely.total_cmp(&b.unlikely));
    let numbers = courses.iter().map(|course| course.looks.len() + 2).sum();
    Judgement { verdict: verdict(&fits), fits, numbers }
}

/// What fits, most likely first, say together.
fn verdict(fits: &[Fit]) -> Verdict {
    let least = fits.first().map_or(0.0, |best| best.unlikely);
    let near = |fit: &&Fit| fit.misfit <= MOST_MISFIT && fit.unlikely - least < TOLD_APART;
    let fitting: Vec<Fit> = fits.iter().filter(near).copied().collect();
    match fitting.as_slice() {
        [] => Verdict::NoneFits,
        [one] => Verdict::Told(*one),
        _ => Verdict::NotToldApart(fitting),
    }
}

/// The best of a family: first roughly, by the shorter courses and few draws, then with all of them.
fn best(courses: &[Course], known: &[Known], family: &[DriftLaw]) -> Fit {
    let rough = |law: &DriftLaw| {
        let short = courses.iter().zip(known).filter(|(course, _)| course.frames.len() <= SHORT);
        let each = short.map(|(course, known)| {
            let predicted = predicted(course, known, *law, ROUGH_DRAWS, false);
            squares(&predicted.rests(&shown(course, known.follower))) + predicted.breadth()
        });
        each.sum::<f64>()
    };
    let unlikely: Vec<f64> = family.iter().map(rough).collect();
    let mut at =
        (0..family.len()).min_by(|a, b| unlikely[*a].total_cmp(&unlikely[*b])).unwrap_or(0);
    let mut tried: Vec<Option<Replayed>> = family.iter().map(|_| None).collect();
    let mut of = |at: usize| -> (f64, f64) {
        let replayed = tried[at].get_or_insert_with(|| Replayed::new(courses, known, family[at]));
        (replayed.unlikely, replayed.misfit)
    };
    // Uphill to the likeliest, but not for a law that is far from fitting.
    while of(at).1 <= FAR {
        let beside = [at.checked_sub(1), Some(at + 1).filter(|next| *next < family.len())];
        let better = beside.into_iter().flatten().find(|next| of(*next).0 < of(at).0);
        let Some(better) = better else { break };
        at = better;
    }
    let (unlikely, misfit) = of(at);
    let beside = |next: Option<usize>| tried.get(next?)?.as_ref();
    let neighbours = beside(at.checked_sub(1)).zip(beside(Some(at + 1)));
    let parameter = neighbours.zip(tried[at].as_ref()).map(|((below, above), here)| {
        let (steps, error) = here.refine(below, above);
        // What fits worse than chance would have it is known worse, too.
        let error = (error * misfit.max(1.0)).hypot(LEAST_ERROR);
        match family[at] {
            DriftLaw::Hold { phase } | DriftLaw::Block { phase } => {
                (f64::from(phase) + steps, error)
            }
            // Gains double from one to the next.
            DriftLaw::Proportional { gain, .. } => {
                let gain = f64::from(gain) * steps.exp2();
                (gain, gain * std::f64::consts::LN_2 * error)
            }
        }
    });
    Fit { law: family[at], misfit, unlikely, parameter }
}

/// All courses of one follower under one law.
struct Replayed {
    each: Vec<(Prediction, Vec<f64>)>,
    unlikely: f64,
    misfit: f64,
}

impl Replayed {
    fn new(courses: &[Course], known: &[Known], law: DriftLaw) -> Self {
        let (mut square, mut breadth, mut numbers) = (0.0, 0.0, 0);
        let each = courses.iter().zip(known).map(|(course, known)| {
            let predicted = predicted(course, known, law, DRAWS, true);
            let rests = predicted.rests(&shown(course, known.follower));
            square += squares(&rests);
            breadth += predicted.breadth();
            numbers += rests.len();
            (predicted, rests)
        });
        let each = each.collect();
        let misfit = (square / f64::from(numbers.max(1) as u32)).sqrt();
        Self { each, unlikely: square + breadth, misfit }
    }

    /// Where between its neighbours the parameter fits best, in steps from here, and the standard
    /// error: one step of least squares.
    fn refine(&self, below: &Self, above: &Self) -> (f64, f64) {
        let (mut product, mut square) = (0.0, 0.0);
        for (at, (here, rests)) in self.each.iter().enumerate() {
            // The effect halves with each step of the exponent, so the nearer slope is the mean of
            // both sides.
            let slope = here.change(&below.each[at].0, &above.each[at].0);
            product += slope.iter().zip(rests).map(|(slope, rest)| slope / 2.0 * rest).sum::<f64>();
            square += squares(&slope) / 4.0;
        }
        match square > 0.0 {
            true => (product / square, 1.0 / square.sqrt()),
            false => (0.0, f64::INFINITY),
        }
    }
}

fn squares(rests: &[f64]) -> f64 {
    rests.iter().map(|rest| rest * rest).sum()
}

/// What a law would have shown in a course, with several draws of what is not known exactly. They
/// are the same for each law.
fn predicted(
    course: &Course,
    known: &Known,
    law: DriftLaw,
    draws: u64,
    together: bool,
) -> Prediction {
    let drawn: Vec<Vec<f64>> = (0..draws)
        .map(|number| {
            let mut chance = Stream::new(SEED, "calibrate", number);
            predict(course, law, known, &mut chance)
        })
        .collect();
    Prediction::of(&drawn, &reading_variances(course, known.follower), together)
}

const fn hold(phase: u8) -> DriftLaw {
    DriftLaw::Hold { phase }
}

const fn block(phase: u8) -> DriftLaw {
    DriftLaw::Block { phase }
}

const fn proportional(gain: u16) -> DriftLaw {
    DriftLaw::Proportional { gain, limit: 1_000 }
}

/// The laws that are tried, by family, each with its parameter in order: what the public record
/// admits and some more on both sides.
const FAMILIES: [&[DriftLaw]; 3] = [
    &[hold(6), hold(7), hold(8), hold(9), hold(10), hold(11), hold(12), hold(13), hold(14)],
    &[
        block(6),
        block(7),
        block(8),
        block(9),
        block(10),
        block(11),
        block(12),
        block(13),
        block(14),
    ],
    &[proportional(1), proportional(2), proportional(4), proportional(8), proportional(16)],
];
/// A law fits up to this misfit, in standard deviations.
pub const MOST_MISFIT: f64 = 3.0;
/// Laws are told apart by this difference of likelihood: five standard deviations.
pub const TOLD_APART: f64 = 25.0;
/// What the exponent can be off by however good the figures are: rounding of a step.
const LEAST_ERROR: f64 = 0.0005;
/// Draws of what is not known exactly, for a first look and for the figures.
const ROUGH_DRAWS: u64 = 4;
const DRAWS: u64 = 40;
/// Drift frames of a course that is looked at first.
const SHORT: usize = 300;
/// Misfit of a law whose parameter is of no interest.
const FAR: f64 = 6.0;
/// The draws are the same in each judgement.
const SEED: u64 = 1;

#[cfg(test)]
mod tests {
    use super::*;

    fn fit(law: DriftLaw, misfit: f64, unlikely: f64) -> Fit {
        Fit { law, misfit, unlikely, parameter: None }
    }

    /// Both sides of both limits.
    #[test]
    fn one_several_or_none_fit() {
        let told = |fits: [Fit; 2]| match verdict(&fits) {
            Verdict::Told(_) => 1,
            Verdict::NotToldApart(several) => several.len(),
            Verdict::NoneFits => 0,
        };
        let pair =
            |a: (f64, f64), b: (f64, f64)| [fit(hold(10), a.0, a.1), fit(block(9), b.0, b.1)];
        assert_eq!(told(pair((1.0, 50.0), (1.2, 75.0))), 1);
        assert_eq!(told(pair((1.0, 50.0), (1.2, 74.9))), 2);
        assert_eq!(told(pair((2.9, 410.0), (3.01, 420.0))), 1);
        assert_eq!(told(pair((3.0, 410.0), (3.01, 420.0))), 1);
        assert_eq!(told(pair((3.01, 420.0), (3.02, 425.0))), 0);
    }
}
