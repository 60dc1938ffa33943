//! Sharing a number of clusters among tables by what each further cluster gains.

/// Shares `total` clusters: one for each list of gains, then one at a time to the list whose next
/// cut gains most, the first of equal ones.
///
/// `gains` are those of splitting alone, each in the order its own heap made the cuts. The next
/// gain of a list is the top of its heap, so this is the same as one heap over all lists.
pub(crate) fn share(gains: &[&[f64]], total: usize) -> Vec<usize> {
    let mut counts = vec![1; gains.len()];
    for _ in gains.len()..total {
        let next = |list: usize| gains[list].get(counts[list] - 1).copied();
        let open = (0..gains.len()).filter_map(|list| next(list).map(|gain| (list, gain)));
        let best = open.reduce(|best, list| if list.1 > best.1 { list } else { best });
        let Some((list, _)) = best else { break };
        counts[list] += 1;
    }
    counts
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clusters_go_where_they_gain_most() {
        let counts = share(&[&[9.0, 1.0], &[5.0, 4.0, 0.5], &[]], 6);
        assert_eq!(counts, [2, 3, 1]);
    }

    #[test]
    fn a_gain_hidden_behind_a_smaller_one_waits_for_its_turn() {
        // Splitting may open a cut that gains more than the one that led to it.
        assert_eq!(share(&[&[2.0, 8.0], &[3.0, 1.0]], 3), [1, 2]);
        assert_eq!(share(&[&[2.0, 8.0], &[3.0, 1.0]], 5), [3, 2]);
    }

    #[test]
    fn more_clusters_than_there_are_cuts_are_left_over() {
        assert_eq!(share(&[&[1.0], &[]], 100), [2, 1]);
        assert_eq!(share(&[], 100), [0usize; 0]);
    }
}
