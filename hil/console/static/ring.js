// Rows of a recording in memory of fixed size: the newest stay, whatever the length of the run.
const MOST_VALUES = 4_000_000; // 32 MB
const SPAN_S = 180;

export class Ring {
  constructor(channels, rate) {
    this.names = channels.map(([name]) => name);
    this.units = Object.fromEntries(channels);
    this.width = channels.length;
    this.capacity = Math.max(1024, Math.min(Math.ceil(SPAN_S * rate), Math.floor(MOST_VALUES / this.width)));
    this.values = new Float64Array(this.capacity * this.width);
    this.time = this.names.indexOf("time");
    this.end = 0; // rows ever put
  }

  get begin() {
    return Math.max(0, this.end - this.capacity);
  }

  put(rows) {
    const { width, capacity } = this;
    for (let from = 0; from < rows.length; from += width) {
      this.values.set(rows.subarray(from, from + width), (this.end % capacity) * width);
      this.end += 1;
    }
  }

  at(row, column) {
    return this.values[(row % this.capacity) * this.width + column];
  }

  get newest() {
    return this.end ? this.at(this.end - 1, this.time) : NaN;
  }

  get oldest() {
    return this.end ? this.at(this.begin, this.time) : NaN;
  }

  // First row whose time is at least t.
  row(t) {
    let [low, high] = [this.begin, this.end];
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.at(middle, this.time) < t) low = middle + 1;
      else high = middle;
    }
    return low;
  }

  // Mean rate at which a channel has changed over the newest rows of so many seconds; NaN where that is not known.
  rate(name, seconds) {
    const [column, last] = [this.names.indexOf(name), this.end - 1];
    const from = this.end ? this.row(this.newest - seconds) : 0;
    if (column < 0 || from >= last) return NaN;
    return (this.at(last, column) - this.at(from, column)) / (this.newest - this.at(from, this.time));
  }

  column(name, from, to) {
    const column = this.names.indexOf(name);
    const found = new Float64Array(Math.max(0, to - from));
    for (let row = from; row < to; row += 1) found[row - from] = this.at(row, column);
    return found;
  }
}

// What a signal is like: amplitude is half of peak to peak, frequency is that of rising crossings of the mean.
export function measure(time, values) {
  let [low, high, sum, squares, count] = [Infinity, -Infinity, 0, 0, 0];
  for (const value of values) {
    if (Number.isNaN(value)) continue;
    low = Math.min(low, value);
    high = Math.max(high, value);
    sum += value;
    count += 1;
  }
  if (!count) return null;
  const mean = sum / count;
  const amplitude = 0.5 * (high - low);
  const [upper, lower] = [mean + 0.2 * amplitude, mean - 0.2 * amplitude];
  let [below, crossing, first, last, turns] = [false, NaN, NaN, NaN, -1];
  for (let i = 0; i < values.length; i += 1) {
    const value = values[i];
    if (Number.isNaN(value)) continue;
    squares += (value - mean) ** 2;
    if (value < lower) {
      below = true;
      crossing = NaN;
    } else if (below) {
      if (Number.isNaN(crossing) && value >= mean && i) {
        const step = value - values[i - 1];
        crossing = time[i] - (step ? ((value - mean) / step) * (time[i] - time[i - 1]) : 0);
      } else if (value < mean) crossing = NaN;
      if (value > upper) {
        if (turns < 0) first = crossing;
        last = crossing;
        turns += 1;
        below = false;
      }
    }
  }
  const frequency = turns > 0 && amplitude > 0 ? turns / (last - first) : NaN;
  return { now: values[values.length - 1], low, high, mean, amplitude, rms: Math.sqrt(squares / count), frequency };
}

// A column as uPlot draws it: what is not known is a gap. One NaN would leave the whole pane without a scale.
export function drawable(column) {
  return column.some(Number.isNaN) ? Array.from(column, (value) => (Number.isNaN(value) ? null : value)) : column;
}
