/* The last samples of a vector, with their times. Bounded: the oldest are overwritten. */

export class Series {
  constructor(columns, capacity = 8192) {
    this.capacity = capacity;
    this.t = new Float64Array(capacity);
    this.columns = Array.from({length: columns}, () => new Float64Array(capacity));
    this.clear();
  }

  clear() {
    this.count = 0;
    this.next = 0;
  }

  push(t, values) {
    this.t[this.next] = t;
    this.columns.forEach((column, i) => (column[this.next] = values[i]));
    this.next = (this.next + 1) % this.capacity;
    this.count = Math.min(this.count + 1, this.capacity);
  }

  /** Place in the arrays of the sample of this age; 0 is the latest. */
  at(age) {
    return (this.next - 1 - age + 2 * this.capacity) % this.capacity;
  }

  latest() {
    return this.count ? this.columns.map((column) => column[this.at(0)]) : null;
  }

  latest_t() {
    return this.count ? this.t[this.at(0)] : NaN;
  }

  /** The latest `n` values of a column, oldest first. */
  tail(column, n) {
    n = Math.min(n, this.count);
    return Array.from({length: n}, (_, i) => this.columns[column][this.at(n - 1 - i)]);
  }

  /** Points {x: t - now, y} of a column since now - span, oldest first, with a hole (y: NaN) where nothing came for a
   * second. Of more than `points` samples the least and the largest of each part remain: no peak is lost. */
  points(column, now, span, points = 300) {
    let n = 0;
    while (n < this.count && this.t[this.at(n)] >= now - span) n++;
    const y = this.columns[column],
      out = [];
    const step = Math.max(1, Math.ceil((2 * n) / points));
    let before = NaN;
    for (let age = n - 1; age >= 0; age -= step) {
      let low = this.at(age),
        high = low;
      for (let k = 1; k < step && age - k >= 0; k++) {
        const i = this.at(age - k);
        low = y[i] < y[low] ? i : low;
        high = y[i] > y[high] ? i : high;
      }
      const order = low === high ? [low] : this.t[low] < this.t[high] ? [low, high] : [high, low];
      if (this.t[order[0]] - before > 1) out.push({x: this.t[order[0]] - now, y: NaN});
      for (const i of order) out.push({x: this.t[i] - now, y: y[i]});
      before = this.t[order[order.length - 1]];
    }
    return out;
  }
}
