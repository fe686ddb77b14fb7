//! Checks files of picture pairs in the layout of `fixtures/image-metrics`:
//! `cargo run -p image-metrics --example check_golden_metrics -- FILE…`. Exits with 1 outside tolerance.

#[path = "../tests/it/golden.rs"]
mod golden;

fn main() -> std::process::ExitCode {
    let mut good = true;
    for file in std::env::args().skip(1) {
        for (pair, psnr, ssim) in golden::deviations(file.as_ref()) {
            let holds = psnr <= golden::TOLERANCE && ssim <= golden::TOLERANCE;
            good &= holds;
            println!(
                "{file} {pair}: PSNR off by {psnr:.1e} dB, SSIM by {ssim:.1e}{}",
                if holds { "" } else { " FAILED" }
            );
        }
    }
    if good { 0.into() } else { 1.into() }
}
