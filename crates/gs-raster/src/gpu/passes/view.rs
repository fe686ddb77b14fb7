//! Carries out the commands of a view.

use crate::gpu::context::{Gpu, Recording};
use crate::gpu::forward::Buffers;
use crate::gpu::upload::Upload;
use gs_shaders::{Action, Argument, Counts, Groups, View, Word, folded};

impl Gpu {
    /// Records every command of a view.
    pub(in crate::gpu) fn carry_out(
        &mut self,
        recording: &mut Recording,
        view: &View,
        counts: &Counts,
        upload: &Upload,
        buffers: &mut Buffers,
    ) {
        for command in view.commands.iter().filter(|command| command.applies(counts.tiles)) {
            match &command.action {
                Action::Clear(name) => recording.encoder.clear_buffer(buffers.get(name), 0, None),
                Action::Swap(a, b) => buffers.swap(a, b),
                Action::Dispatch { pass, entry_point, arguments, groups } => {
                    let words = arguments.iter().flatten().find_map(|argument| match argument {
                        Argument::Words(words) => Some(self.pool.uniform(&words_of(words, counts))),
                        Argument::Buffer(_) => None,
                    });
                    let bound: Vec<_> = arguments
                        .iter()
                        .map(|argument| match argument.as_ref()? {
                            Argument::Words(_) => words.as_ref(),
                            Argument::Buffer("geometry") => Some(&upload.geometry),
                            Argument::Buffer("sh") => Some(&upload.sh),
                            Argument::Buffer(name) => Some(buffers.get(name)),
                        })
                        .collect();
                    let groups = match groups {
                        Groups::Folded(n) => folded(word(n.value(counts))),
                        Groups::Tiles => buffers.frame.tiles,
                    };
                    self.dispatch(recording, pass, entry_point, view.features, groups, &bound);
                    recording.keep.extend(words);
                }
            }
        }
    }
}

fn words_of(words: &[Word; 4], counts: &Counts) -> [u32; 4] {
    words.each_ref().map(|one| match one {
        Word::Is(value) => *value,
        Word::Amount(amount) => word(amount.value(counts)),
    })
}

fn word(value: u64) -> u32 {
    u32::try_from(value).expect("amounts of a view that fits the device fit a word")
}
