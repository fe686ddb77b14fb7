//! Names of the instruction sets that this machine has, the narrowest first.

fn main() {
    for isa in cpu_isa::Isa::available() {
        println!("{isa}");
    }
}
