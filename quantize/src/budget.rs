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

/// Shares `budget` bytes: a cluster for each list, then one at a time to the list whose next cut
/// gains most for each byte of its clusters, among those that still fit.
///
/// `None` when one cluster for each list is too much. This is the greedy choice along the lower
/// hull of error over bytes that codes are allotted bits by [Shoham88]; it is off the best by less
/// than one cluster where gains fall.
pub(crate) fn share_bytes(gains: &[&[f64]], bytes: &[u64], budget: u64) -> Option<Vec<usize>> {
    let mut counts = vec![1; gains.len()];
    let mut left = bytes.iter().try_fold(budget, |left, bytes| left.checked_sub(*bytes))?;
    loop {
        let gain = |list: usize| {
            let gain = gains[list].get(counts[list] - 1)?;
            (bytes[list] <= left).then(|| gain / bytes[list].max(1) as f64)
        };
        let open = (0..gains.len()).filter_map(|list| gain(list).map(|gain| (list, gain)));
        let best = open.reduce(|best, list| if list.1 > best.1 { list } else { best });
        let Some((list, _)) = best else { return Some(counts) };
        counts[list] += 1;
        left -= bytes[list];
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_go_where_each_gains_most_and_are_never_exceeded() {
        let gains: [&[f64]; 2] = [&[8.0, 6.0, 1.0], &[5.0, 4.0]];
        // A cluster of the first list takes four times the bytes of the second's.
        assert_eq!(share_bytes(&gains, &[4, 1], 5), Some(vec![1, 1]));
        assert_eq!(share_bytes(&gains, &[4, 1], 7), Some(vec![1, 3]));
        assert_eq!(share_bytes(&gains, &[4, 1], 11), Some(vec![2, 3]));
        assert_eq!(share_bytes(&gains, &[4, 1], 1000), Some(vec![4, 3]));
        assert_eq!(share_bytes(&gains, &[4, 1], 4), None);
    }

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
