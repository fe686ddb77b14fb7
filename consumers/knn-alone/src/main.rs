//! What somebody who wants nothing but neighbours writes.

fn main() -> Result<(), knn::Error> {
    let points = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [3.0, 0.0, 0.0], [1.0, 0.0, 0.0]];
    let neighbors = knn::knn(&points, 2)?;
    for (i, point) in points.iter().enumerate() {
        let (indices, sq_distances) = neighbors.row(i);
        println!("{i} at {point:?}: {indices:?}, squared distances {sq_distances:?}");
    }
    assert_eq!(neighbors.row(1), (&[3, 0][..], &[0.0, 1.0][..]));
    Ok(())
}
