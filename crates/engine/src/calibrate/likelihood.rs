//! Likelihood of measured numbers against predicted ones with correlated errors: a shift of a clock
//! at the start moves every number after it.

/// A prediction of several numbers: their means and their covariance.
pub(super) struct Prediction {
    means: Vec<f64>,
    /// Lower triangle L of the covariance L L'.
    root: Vec<Vec<f64>>,
}

impl Prediction {
    /// The prediction from several draws of the unknown quantities, plus the variances of the
    /// readings. `together` means that errors are correlated; it needs at least five draws more
    /// than there are numbers.
    pub fn of(drawn: &[Vec<f64>], readings: &[f64], together: bool) -> Self {
        let (count, numbers) = (drawn.len() as f64, readings.len());
        let means = means(drawn);
        // The mean of few draws has an error, too; and a covariance of few draws looks narrower in
        // some direction than it is (Hartlap, Simon and Schneider, 2007).
        let narrow = if together { (count - 1.0) / (count - numbers as f64 - 2.0) } else { 1.0 };
        let more = (1.0 + 1.0 / count) * narrow;
        let mut covariance = vec![vec![0.0; numbers]; numbers];
        for row in 0..numbers {
            for column in 0..=row {
                if together || row == column {
                    let products = drawn
                        .iter()
                        .map(|one| (one[row] - means[row]) * (one[column] - means[column]));
                    covariance[row][column] = products.sum::<f64>() / (count - 1.0) * more;
                }
            }
            covariance[row][row] += readings[row];
        }
        Self { means, root: root(covariance) }
    }

    /// Measured less predicted, as independent numbers of variance 1.
    pub fn rests(&self, found: &[f64]) -> Vec<f64> {
        let rests: Vec<f64> = found.iter().zip(&self.means).map(|(one, mean)| one - mean).collect();
        self.whitened(&rests)
    }

    /// Change of the numbers from one prediction to another, in the same units as rests.
    pub fn change(&self, from: &[f64], to: &[f64]) -> Vec<f64> {
        let change: Vec<f64> = from.iter().zip(to).map(|(a, b)| b - a).collect();
        self.whitened(&change)
    }

    /// Logarithm of the covariance's determinant: it penalizes a law that predicts anything, since
    /// that fits anything.
    pub fn breadth(&self) -> f64 {
        self.root.iter().enumerate().map(|(at, row)| 2.0 * row[at].ln()).sum()
    }

    fn whitened(&self, numbers: &[f64]) -> Vec<f64> {
        let mut white: Vec<f64> = Vec::with_capacity(numbers.len());
        for (row, number) in self.root.iter().zip(numbers) {
            let before: f64 = row.iter().zip(&white).map(|(factor, one)| factor * one).sum();
            white.push((number - before) / row[white.len()]);
        }
        white
    }
}

/// The mean of each number over several draws.
pub(super) fn means(drawn: &[Vec<f64>]) -> Vec<f64> {
    let mut sums = vec![0.0; drawn.first().map_or(0, Vec::len)];
    for one in drawn {
        for (sum, number) in sums.iter_mut().zip(one) {
            *sum += number;
        }
    }
    sums.iter().map(|sum| sum / drawn.len() as f64).collect()
}

/// Cholesky root of a matrix whose lower triangle is given. Readings have errors of their own, so
/// no variance is zero.
fn root(mut matrix: Vec<Vec<f64>>) -> Vec<Vec<f64>> {
    for row in 0..matrix.len() {
        for column in 0..=row {
            let sum: f64 = (0..column).map(|at| matrix[row][at] * matrix[column][at]).sum();
            let rest = matrix[row][column] - sum;
            matrix[row][column] =
                if row == column { rest.max(LEAST).sqrt() } else { rest / matrix[column][column] };
        }
    }
    matrix
}

/// Lower bound of a variance after rounding.
const LEAST: f64 = 1e-9;

#[cfg(test)]
mod tests {
    use super::*;

    /// Two numbers of variance 4 that move together by half: a rest of (2, 2) is 8/6 squares, one
    /// of (2, -2) is 8/2.
    #[test]
    fn rests_know_what_hangs_together() {
        // Many draws with exactly this covariance.
        let (a, b) = (3f64.sqrt(), 1.0);
        let drawn: Vec<Vec<f64>> = (0..4_000)
            .map(|number| {
                let (x, y) = [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)][number % 4];
                vec![a * x + b * y, a * x - b * y]
            })
            .collect();
        let together = Prediction::of(&drawn, &[0.0, 0.0], true);
        let square = |found: [f64; 2]| -> f64 {
            together.rests(&found).iter().map(|rest| rest * rest).sum()
        };
        assert!((square([2.0, 2.0]) - 8.0 / 6.0).abs() < 0.01, "{}", square([2.0, 2.0]));
        assert!((square([2.0, -2.0]) - 8.0 / 2.0).abs() < 0.02, "{}", square([2.0, -2.0]));
        assert!((together.breadth() - 12f64.ln()).abs() < 0.01, "{}", together.breadth());
        let apart = Prediction::of(&drawn, &[0.0, 0.0], false);
        let square: f64 = apart.rests(&[2.0, -2.0]).iter().map(|rest| rest * rest).sum();
        assert!((square - 2.0).abs() < 0.01, "{square}");
    }
}
