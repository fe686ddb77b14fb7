//! The naga gate.
use gs_shaders::*;
#[test]
fn t() {
    for pass in PASSES {
        let src = pass.source();
        let module = match naga::front::wgsl::parse_str(&src) {
            Ok(m) => m,
            Err(e) => panic!("{}", e.emit_to_string_with_path(&src, pass.name)),
        };
        let mut v = naga::valid::Validator::new(
            naga::valid::ValidationFlags::all(),
            naga::valid::Capabilities::default(),
        );
        let info = match v.validate(&module) {
            Ok(i) => i,
            Err(e) => panic!("{}", e.emit_to_string_with_path(&src, pass.name)),
        };
        for f in Features::all() {
            let c: naga::back::PipelineConstants =
                pass.constants(f).into_iter().map(|(k, v)| (k.to_owned(), v)).collect();
            for e in pass.entry_points {
                let (m, i) = naga::back::pipeline_constants::process_overrides(
                    &module,
                    &info,
                    Some((naga::ShaderStage::Compute, e.name)),
                    &c,
                )
                .unwrap();
                let _ = (m, i);
            }
        }
        println!("{} ok", pass.name);
    }
}
