//! Which law a follower keeps: misfits of each, and the phase parameter that fits best.

use isocat_esc::DriftLaw;
use isocat_sim::random::Stream;

use super::course::Course;
use super::replay::{Known, predict, reading_variances, shown};

/// How well one law fits.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Fit {
    /// The law, with the parameter that fits best.
    pub law: DriftLaw,
    /// Root mean square of measured less predicted, in standard deviations.
    pub misfit: f64,
    /// Sum of the squares.
    pub square: f64,
    /// The phase parameter as a real number, and its standard error; `None` for a law that has
    /// none.
    pub phase: Option<(f64, f64)>,
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
    fits.sort_by(|a, b| a.square.total_cmp(&b.square));
    let numbers = courses.iter().map(|course| course.looks.len() + 2).sum();
    Judgement { verdict: verdict(&fits), fits, numbers }
}

/// What fits, best first, say together.
fn verdict(fits: &[Fit]) -> Verdict {
    let least = fits.first().map_or(0.0, |best| best.square);
    let near = |fit: &&Fit| fit.misfit <= MOST_MISFIT && fit.square - least < TOLD_APART;
    let fitting: Vec<Fit> = fits.iter().filter(near).copied().collect();
    match fitting.as_slice() {
        [] => Verdict::NoneFits,
        [one] => Verdict::Told(*one),
        _ => Verdict::NotToldApart(fitting),
    }
}

/// The best of a family: first roughly, then with all draws.
fn best(courses: &[Course], known: &[Known], family: &[DriftLaw]) -> Fit {
    let rough = |law: &DriftLaw| misfit(courses, known, *law, ROUGH_DRAWS).0;
    let squares: Vec<f64> = family.iter().map(rough).collect();
    let at = (0..family.len()).min_by(|a, b| squares[*a].total_cmp(&squares[*b])).unwrap_or(0);
    let law = family[at];
    let (square, numbers) = misfit(courses, known, law, DRAWS);
    let phase = phase_of(law).and_then(|middle| {
        let (below, above) = (family.get(at.checked_sub(1)?)?, family.get(at + 1)?);
        Some(refine(courses, known, (*below, law, *above), middle))
    });
    let misfit = (square / numbers as f64).sqrt();
    // What fits worse than chance would have it is known worse, too.
    let honest = |(found, error): (f64, f64)| (found, (error * misfit.max(1.0)).hypot(LEAST_ERROR));
    Fit { law, misfit, square, phase: phase.map(honest) }
}

/// Sum of the squares of measured less predicted, in standard deviations, and how many they are.
fn misfit(courses: &[Course], known: &[Known], law: DriftLaw, draws: u64) -> (f64, usize) {
    let (mut square, mut numbers) = (0.0, 0);
    for (course, known) in courses.iter().zip(known) {
        let predicted = Predicted::of(course, *known, law, draws);
        for (found, (mean, variance)) in shown(course, known.follower).iter().zip(predicted.each())
        {
            square += (found - mean) * (found - mean) / variance;
            numbers += 1;
        }
    }
    (square, numbers)
}

/// Where between its neighbours the parameter fits best, by one step of least squares.
fn refine(
    courses: &[Course],
    known: &[Known],
    (below, law, above): (DriftLaw, DriftLaw, DriftLaw),
    middle: f64,
) -> (f64, f64) {
    let (mut product, mut square) = (0.0, 0.0);
    for (course, known) in courses.iter().zip(known) {
        let here = Predicted::of(course, *known, law, DRAWS);
        let low = Predicted::of(course, *known, below, ROUGH_DRAWS);
        let high = Predicted::of(course, *known, above, ROUGH_DRAWS);
        let found = shown(course, known.follower);
        for (at, (mean, variance)) in here.each().enumerate() {
            // The effect halves with each step of the exponent, so the nearer slope is the mean of
            // both sides.
            let slope = (high.means[at] - low.means[at]) / 2.0;
            product += slope * (found[at] - mean) / variance;
            square += slope * slope / variance;
        }
    }
    match square > 0.0 {
        true => (middle + product / square, 1.0 / square.sqrt()),
        false => (middle, f64::INFINITY),
    }
}

/// What a law would have shown in a course: mean and variance of several draws of what is not known
/// exactly.
struct Predicted {
    means: Vec<f64>,
    variances: Vec<f64>,
}

impl Predicted {
    fn of(course: &Course, known: Known, law: DriftLaw, draws: u64) -> Self {
        let drawn: Vec<Vec<f64>> = (0..draws)
            .map(|number| {
                let mut chance = Stream::new(SEED, "calibrate", number);
                predict(course, law, known, Some(&mut chance))
            })
            .collect();
        let readings = reading_variances(course, known.follower);
        let count = draws as f64;
        let (mut means, mut variances) = (Vec::new(), Vec::new());
        for (at, reading) in readings.iter().enumerate() {
            let mean = drawn.iter().map(|one| one[at]).sum::<f64>() / count;
            let spread: f64 = drawn.iter().map(|one| (one[at] - mean) * (one[at] - mean)).sum();
            means.push(mean);
            variances.push(reading + spread / (count - 1.0) * (1.0 + 1.0 / count));
        }
        Self { means, variances }
    }

    fn each(&self) -> impl Iterator<Item = (f64, f64)> + '_ {
        self.means.iter().copied().zip(self.variances.iter().copied())
    }
}

fn phase_of(law: DriftLaw) -> Option<f64> {
    match law {
        DriftLaw::Hold { phase } | DriftLaw::Block { phase } => Some(f64::from(phase)),
        DriftLaw::Proportional { .. } => None,
    }
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
/// Laws are told apart by this difference of squares: five standard deviations.
pub const TOLD_APART: f64 = 25.0;
/// What the phase parameter can be off by however good the figures are: rounding of a step, frames
/// whose instant is known by the host's clock alone.
const LEAST_ERROR: f64 = 0.01;
/// Draws of what is not known exactly, for a first look and for the figures.
const ROUGH_DRAWS: u64 = 2;
const DRAWS: u64 = 8;
/// The draws are the same in each judgement.
const SEED: u64 = 1;

#[cfg(test)]
mod tests {
    use super::*;

    fn fit(law: DriftLaw, misfit: f64, square: f64) -> Fit {
        Fit { law, misfit, square, phase: None }
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
