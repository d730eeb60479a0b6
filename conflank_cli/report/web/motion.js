// The cutter's motion along the posted program: poses as the program's reader gave them, and the ways between them.

export class Motion {
  constructor(report, arrays) {
    this.tip = arrays.tip;
    this.axis = arrays.axis;
    this.rotary = arrays.rotary;
    this.point = arrays.point;
    this.feed = arrays.feed;
    this.block = arrays.block;
    this.cut = arrays.cut;
    this.tool = arrays.tool;
    this.joined = arrays.joined;
    this.rapid = arrays.rapid;
    this.count = this.block.length;
    this.letters = report.program.letters;
    // Time at which each pose is reached, s.
    this.time = new Float64Array(this.count);
    for (let k = 1; k < this.count; k++) this.time[k] = this.time[k - 1] + arrays.seconds[k];
    this.duration = this.count ? this.time[this.count - 1] : 0;
  }

  // Pose i as the reader gave it.
  pose(i) {
    const three = (values) => Array.from(values.subarray(3 * i, 3 * i + 3));
    return {
      index: i,
      block: this.block[i],
      tip: three(this.tip),
      axis: three(this.axis),
      point: three(this.point),
      rotary_deg: Array.from(this.rotary.subarray(2 * i, 2 * i + 2)),
      feed_mm_min: this.feed[i],
      rapid: Boolean(this.rapid[i]),
      cut: this.cut[i],
      tool: this.tool[i],
      time_s: this.time[i],
    };
  }

  // Index of the last pose that is reached at a time, s.
  at(time) {
    let low = 0;
    let high = this.count - 1;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (this.time[middle] <= time) low = middle;
      else high = middle - 1;
    }
    return low;
  }

  // Tip and axis at a time between two poses: the tip goes straight, the axis swings from one to the other.
  between(time) {
    const i = this.at(time);
    const next = Math.min(i + 1, this.count - 1);
    const span = this.time[next] - this.time[i];
    const share = span > 0 && this.joined[next] ? Math.min((time - this.time[i]) / span, 1) : 0;
    const tip = [];
    const axis = [];
    for (let k = 0; k < 3; k++) {
      tip.push(this.tip[3 * i + k] + share * (this.tip[3 * next + k] - this.tip[3 * i + k]));
      axis.push(this.axis[3 * i + k] + share * (this.axis[3 * next + k] - this.axis[3 * i + k]));
    }
    const length = Math.hypot(...axis) || 1;
    return { index: i, tip, axis: axis.map((value) => value / length) };
  }
}
