/* Spectrum of vibration by Welch's method. */

/** Discrete Fourier transform in place; the length is a power of two. */
export function fft(re, im) {
  const n = re.length;
  for (let i = 1, j = 0; i < n; i++) {
    let bit = n >> 1;
    for (; j & bit; bit >>= 1) j ^= bit;
    j ^= bit;
    if (i < j) {
      [re[i], re[j]] = [re[j], re[i]];
      [im[i], im[j]] = [im[j], im[i]];
    }
  }
  for (let size = 2; size <= n; size *= 2) {
    const half = size / 2;
    for (let k = 0; k < half; k++) {
      const angle = (-2 * Math.PI * k) / size;
      const c = Math.cos(angle),
        s = Math.sin(angle);
      for (let a = k; a < n; a += size) {
        const b = a + half;
        const x = re[b] * c - im[b] * s,
          y = re[b] * s + im[b] * c;
        re[b] = re[a] - x;
        im[b] = im[a] - y;
        re[a] += x;
        im[a] += y;
      }
    }
  }
}

/** {hz, density}: frequencies, and the root of the one-sided power density in unit/sqrt(Hz), of evenly spaced samples.
 * Segments of `size` samples that overlap by half, their mean removed, Hann window. null: fewer samples than `size`. */
export function spectrum(samples, rate_hz, size = 256) {
  if (samples.length < size) return null;
  const window = Float64Array.from({length: size}, (_, i) => 0.5 - 0.5 * Math.cos((2 * Math.PI * i) / size));
  const weight = window.reduce((sum, w) => sum + w * w, 0);
  const power = new Float64Array(size / 2);
  let segments = 0;
  for (let begin = 0; begin + size <= samples.length; begin += size / 2, segments++) {
    const part = samples.slice(begin, begin + size);
    const mean = part.reduce((sum, v) => sum + v, 0) / size;
    const re = Float64Array.from(part, (v, i) => (v - mean) * window[i]),
      im = new Float64Array(size);
    fft(re, im);
    for (let k = 1; k < size / 2; k++) power[k] += re[k] * re[k] + im[k] * im[k];
  }
  const hz = [],
    density = [];
  for (let k = 1; k < size / 2; k++) {
    hz.push((k * rate_hz) / size);
    density.push(Math.sqrt((2 * power[k]) / (segments * weight * rate_hz)));
  }
  return {hz, density};
}
