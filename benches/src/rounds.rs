//! Interleaved timing. In each round every contender makes its pass once, so that a slow moment of the
//! machine hits all of them. The figure compared is the median, over the rounds, of the ratio within a
//! round.

use std::time::Instant;

/// One of the programs compared.
pub struct Contender<'a> {
    pub name: &'static str,
    /// One pass over all items; the sum is returned so that nothing is optimised away.
    pub pass: Box<dyn FnMut() -> usize + 'a>,
}

/// The result of one contender.
pub struct Timing {
    pub name: &'static str,
    /// Median nanoseconds per item.
    pub nanoseconds: f64,
    /// Median over the rounds of the reference's time divided by this contender's.
    pub ratio: f64,
    /// Quartiles of that ratio.
    pub quartiles: [f64; 2],
}

/// Times `contenders` over passes of `items` items. The first contender is the reference.
pub fn interleave(contenders: &mut [Contender], items: usize, rounds: usize) -> Vec<Timing> {
    let count = contenders.len();
    let mut times = vec![Vec::with_capacity(rounds); count];
    for contender in contenders.iter_mut() {
        std::hint::black_box((contender.pass)());
    }
    for round in 0..rounds {
        for turn in 0..count {
            // The first contender of a round rotates.
            let index = (round + turn) % count;
            let start = Instant::now();
            std::hint::black_box((contenders[index].pass)());
            times[index].push(start.elapsed().as_nanos() as f64 / items as f64);
        }
    }
    let timing = |(contender, own): (&Contender, &Vec<f64>)| {
        let mut ratios: Vec<f64> = times[0].iter().zip(own).map(|(first, own)| first / own).collect();
        Timing {
            name: contender.name,
            nanoseconds: quantile(&mut own.clone(), 0.5),
            ratio: quantile(&mut ratios, 0.5),
            quartiles: [quantile(&mut ratios, 0.25), quantile(&mut ratios, 0.75)],
        }
    };
    contenders.iter().zip(&times).map(timing).collect()
}

fn quantile(values: &mut [f64], share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    values[((values.len() - 1) as f64 * share).round() as usize]
}
