//! The three nearest points of each of ten thousand. `cargo run --release -p knn --example neighbours`

fn main() -> Result<(), knn::Error> {
    let points: Vec<[f32; 3]> = (0..10_000u32)
        .map(|i| {
            let (row, column) = ((i / 100) as f32, (i % 100) as f32);
            [column, row, (0.1 * column).sin() + (0.1 * row).cos()]
        })
        .collect();
    let neighbors = knn::knn(&points, 3)?;
    let (indices, sq_distances) = neighbors.row(5050);
    println!("the nearest of point 5050 are {indices:?}, at squared distances {sq_distances:?}");
    Ok(())
}
