//! Finds the path with the largest gain through a table, by dynamic programming.
//!
//! From: the Viterbi algorithm.

/// The column of each row on the path with the largest gain: the sum of its values in the table
/// less `cost_of_a_step` for each column that it moves. From row `i` to the next, a path moves at
/// most `max_steps[i]` columns, and any number of columns after the end of that list. Of origins
/// with equal gain the nearest is taken.
pub fn best_path(table: &[Vec<f64>], cost_of_a_step: f64, max_steps: &[usize]) -> Vec<usize> {
    let Some(first) = table.first().filter(|row| !row.is_empty()) else { return Vec::new() };
    let columns = first.len();
    let mut best: Vec<f64> = first.clone();
    let mut came_from: Vec<Vec<usize>> = Vec::new();
    for (i, row) in table[1..].iter().enumerate() {
        let max_step = max_steps.get(i).copied().unwrap_or(columns);
        let origins: Vec<(f64, usize)> =
            (0..columns).map(|i| best_origin(&best, i, cost_of_a_step, max_step)).collect();
        best = origins.iter().zip(row).map(|((value, _), gain)| value + gain).collect();
        came_from.push(origins.into_iter().map(|(_, origin)| origin).collect());
    }
    let mut column = (0..columns).max_by(|&a, &b| best[a].total_cmp(&best[b])).unwrap_or(0);
    let mut path = vec![column];
    for origin in came_from.iter().rev() {
        column = origin[column];
        path.push(column);
    }
    path.reverse();
    path
}

/// The largest gain with which column `i` can be reached, and the column of the row before from
/// which it is reached.
fn best_origin(best: &[f64], i: usize, cost_of_a_step: f64, max_step: usize) -> (f64, usize) {
    let mut found = (best[i], i);
    for step in 1..=max_step.min(best.len() - 1) {
        let cost = cost_of_a_step * step as f64;
        let below = i.checked_sub(step);
        for origin in below.into_iter().chain((i + step < best.len()).then_some(i + step)) {
            if best[origin] - cost > found.0 {
                found = (best[origin] - cost, origin);
            }
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_path_follows_the_gain_but_does_not_jump_for_little() {
        let row = |at: usize, gain: f64| {
            let mut row = vec![0.0; 5];
            row[at] = gain;
            row
        };
        let table = [row(0, 10.0), row(4, 1.0), row(0, 10.0), row(4, 10.0), row(4, 10.0)];
        assert_eq!(best_path(&table, 1.0, &[]), [0, 0, 0, 4, 4]);
    }

    #[test]
    fn a_path_makes_no_step_that_is_too_large() {
        let table = [vec![9.0, 0.0, 0.0], vec![1.0, 0.0, 0.0], vec![0.0, 0.0, 9.0]];
        assert_eq!(best_path(&table, 0.1, &[1, 1]), [0, 1, 2]);
        assert_eq!(best_path(&table, 0.1, &[2, 2]), [0, 0, 2]);
        assert_eq!(best_path(&table, 0.1, &[1]), [0, 0, 2], "the second step has no bound");
    }

    #[test]
    fn a_table_without_rows_has_no_path() {
        assert!(best_path(&[], 1.0, &[]).is_empty());
    }
}
