// Positions, speeds and feed over time, one canvas each, with a line at the time that is shown.

const LINES = ["--line-1", "--line-2", "--line-3"];
const PAD = { left: 58, right: 12, top: 8, bottom: 22 };

function ticks(low, high, count) {
  const rough = (high - low) / count || 1;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((k) => k * power).find((each) => each >= rough);
  const found = [];
  for (let k = Math.ceil(low / step); k * step <= high + 1e-9 * step; k++) found.push(Number((k * step).toPrecision(12)));
  return found;
}

function seriesOf(motion, program) {
  const { count, time } = motion;
  const column = (values, width, k, factor = 1) => Float64Array.from({ length: count }, (_, i) => values[width * i + k] * factor);
  const speed = (values) =>
    Float64Array.from({ length: count }, (_, i) => {
      const span = i ? time[i] - time[i - 1] : 0;
      return span > 1e-6 && motion.joined[i] && !motion.rapid[i] ? Math.abs(values[i] - values[i - 1]) / span : NaN;
    });
  const letters = [...program.letters];
  const byRotary = letters.length === 2 && motion.rotary.some((value) => Number.isFinite(value));
  const turned = byRotary
    ? letters.map((letter, k) => ({ name: letter, values: column(motion.rotary, 2, k) }))
    : ["i", "j", "k"].map((name, k) => ({ name, values: column(motion.axis, 3, k) }));
  const rates = byRotary
    ? turned.map(({ name, values }) => ({ name, values: speed(values) }))
    : [{ name: "axis", values: Float64Array.from({ length: count }, (_, i) => {
        const span = i ? time[i] - time[i - 1] : 0;
        if (!(span > 1e-6) || !motion.joined[i] || motion.rapid[i]) return NaN;
        const dot = [0, 1, 2].reduce((sum, k) => sum + motion.axis[3 * i + k] * motion.axis[3 * i - 3 + k], 0);
        return ((Math.acos(Math.min(1, dot)) / span) * 180) / Math.PI;
      }) }];
  return [
    { id: "rotary", title: byRotary ? "Rotary axes, °" : "Tool axis in the program's frame", lines: turned },
    { id: "linear", title: "Programmed point, mm", lines: ["X", "Y", "Z"].map((name, k) => ({ name, values: column(motion.point, 3, k) })) },
    { id: "rates", title: "Speed of the tool axis while cutting, °/s", lines: rates },
    { id: "feed", title: "Feed, mm/min", lines: [{ name: "F", values: Float64Array.from(motion.feed), steps: true }] },
  ];
}

export class Charts {
  constructor(holder, motion, report, seek) {
    this.motion = motion;
    this.report = report;
    this.charts = seriesOf(motion, report.program).map((entry) => {
      const figure = document.createElement("figure");
      const caption = document.createElement("figcaption");
      caption.textContent = `${entry.title} `;
      entry.lines.forEach(({ name }, k) => {
        const key = document.createElement("span");
        key.className = "key";
        key.style.setProperty("--key", `var(${LINES[k]})`);
        key.textContent = name;
        caption.append(key);
      });
      const box = document.createElement("div");
      box.className = "chart";
      const canvas = document.createElement("canvas");
      canvas.setAttribute("role", "img");
      canvas.setAttribute("aria-label", `${entry.title} over time; ${this.words(entry)}`);
      const cursor = document.createElement("div");
      cursor.className = "cursor";
      cursor.style.left = `${PAD.left}px`;
      cursor.style.right = `${PAD.right}px`;
      box.append(canvas, cursor);
      figure.append(caption, box);
      holder.append(figure);
      const at = (event) => {
        const { left, width } = canvas.getBoundingClientRect();
        seek(((event.clientX - left - PAD.left) / (width - PAD.left - PAD.right)) * this.span());
      };
      box.addEventListener("pointerdown", (event) => { box.setPointerCapture(event.pointerId); at(event); });
      box.addEventListener("pointermove", (event) => { if (event.buttons) at(event); });
      return { ...entry, canvas, cursor };
    });
    new ResizeObserver(() => this.draw()).observe(holder);
  }

  span() {
    return this.motion.duration || 1;
  }

  words({ lines }) {
    return lines.map(({ name, values }) => {
      const [low, high] = this.range([{ values }]);
      return `${name} from ${low.toFixed(1)} to ${high.toFixed(1)}`;
    }).join(", ");
  }

  range(lines) {
    let [low, high] = [Infinity, -Infinity];
    for (const { values } of lines) for (const value of values) {
      if (!Number.isFinite(value)) continue;
      low = Math.min(low, value);
      high = Math.max(high, value);
    }
    return low > high ? [0, 1] : [low, high];
  }

  draw() {
    const style = getComputedStyle(document.documentElement);
    const ink = style.getPropertyValue("--ink-soft");
    const rule = style.getPropertyValue("--rule");
    for (const { canvas, lines } of this.charts) {
      const { clientWidth: width, clientHeight: height } = canvas;
      if (!width) continue;
      const ratio = Math.min(window.devicePixelRatio, 2);
      canvas.width = width * ratio;
      canvas.height = height * ratio;
      const pen = canvas.getContext("2d");
      pen.scale(ratio, ratio);
      pen.font = "11px system-ui, sans-serif";
      const inner = { width: width - PAD.left - PAD.right, height: height - PAD.top - PAD.bottom };
      let [low, high] = this.range(lines);
      const rim = 0.06 * (high - low || 1);
      [low, high] = [low - rim, high + rim];
      const x = (time) => PAD.left + (time / this.span()) * inner.width;
      const y = (value) => PAD.top + (1 - (value - low) / (high - low)) * inner.height;
      this.stripes(pen, x, inner);
      pen.lineWidth = 1;
      pen.strokeStyle = rule;
      pen.fillStyle = ink;
      pen.textAlign = "right";
      pen.textBaseline = "middle";
      for (const value of ticks(low, high, 4)) {
        pen.beginPath();
        pen.moveTo(PAD.left, y(value));
        pen.lineTo(PAD.left + inner.width, y(value));
        pen.stroke();
        pen.fillText(String(value), PAD.left - 6, y(value));
      }
      pen.textAlign = "center";
      pen.textBaseline = "top";
      for (const value of ticks(0, this.span(), 8)) pen.fillText(`${value} s`, x(value), PAD.top + inner.height + 6);
      lines.forEach((line, k) => this.line(pen, line, style.getPropertyValue(LINES[k]), x, y));
    }
  }

  // The cuts behind the lines, in their colours.
  stripes(pen, x, inner) {
    const { motion } = this;
    pen.globalAlpha = 0.13;
    for (let i = 1, from = 1; i <= motion.count; i++) {
      if (i < motion.count && motion.cut[i] === motion.cut[from]) continue;
      if (motion.cut[from] >= 0) {
        pen.fillStyle = this.report.cuts[motion.cut[from]].colour;
        const start = x(motion.time[from - 1]);
        pen.fillRect(start, PAD.top, x(motion.time[i - 1]) - start, inner.height);
      }
      from = i;
    }
    pen.globalAlpha = 1;
  }

  line(pen, { values, steps }, colour, x, y) {
    const { time, count, joined } = this.motion;
    pen.strokeStyle = colour;
    pen.lineWidth = 1.5;
    pen.beginPath();
    let drawing = false;
    for (let i = 0; i < count; i++) {
      const known = Number.isFinite(values[i]);
      if (known && drawing && joined[i]) {
        if (steps) pen.lineTo(x(time[i - 1]), y(values[i]));
        pen.lineTo(x(time[i]), y(values[i]));
      } else if (known) {
        pen.moveTo(x(steps && i ? time[i - 1] : time[i]), y(values[i]));
        if (steps) pen.lineTo(x(time[i]), y(values[i]));
      }
      drawing = known;
    }
    pen.stroke();
  }

  at(time) {
    // Moved as a whole, as wide as the chart: nothing is laid out anew then.
    const share = (100 * time) / this.span();
    for (const { cursor } of this.charts) cursor.style.transform = `translateX(${share}%)`;
  }
}
