// The design faces without WebGL: one still picture of each, side by side, from where the view would look at it.

import * as THREE from "three";
import { Face, gapScale } from "./faces.js";

const MARGIN = 40; // pixels of the page around each face
const LEGEND = 80; // below them
const LIGHT = new THREE.Vector3(-0.5, 0.7, 1).normalize(); // in the picture's frame
const SHADE = 0.35; // of the brightness, where the light does not come

export class Picture {
  constructor(canvas, report, arrays, motion) {
    this.canvas = canvas;
    this.report = report;
    this.faces = report.faces.map((entry) => new Face(entry, arrays, report));
    this.scale = gapScale(report.colours, report.tolerance.overcut_um, report.tolerance.undercut_um);
    // The cutter comes from above.
    this.up = new THREE.Vector3();
    for (let i = 0; i < motion.count; i++) {
      if (motion.cut[i] >= 0) this.up.add(new THREE.Vector3(...motion.axis.subarray(3 * i, 3 * i + 3)));
    }
    if (this.up.length() < 1e-3) this.up.set(0, 0, 1);
    this.up.normalize();
    new ResizeObserver(() => this.draw()).observe(canvas);
  }

  paint(mode, shown) {
    this.faces.forEach((face) => face.paint(mode, shown, this.scale));
    this.draw();
  }

  draw() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    const ratio = window.devicePixelRatio;
    this.canvas.width = width * ratio;
    this.canvas.height = height * ratio;
    const pen = this.canvas.getContext("2d");
    pen.scale(ratio, ratio);
    pen.font = "12px system-ui, sans-serif";
    pen.textAlign = "center";
    const each = width / this.faces.length;
    this.faces.forEach((face, k) => {
      pen.fillStyle = getComputedStyle(this.canvas).color;
      pen.fillText(`face ${face.entry.number} ${face.entry.name}`, (k + 0.5) * each, MARGIN);
      this.drawFace(pen, face, k * each, each, height - LEGEND);
    });
  }

  // Right, up and towards the reader, for a look at a face from the cutter's side, a little from above.
  frame(normal) {
    const towards = new THREE.Vector3(...normal);
    towards.addScaledVector(this.up, -towards.dot(this.up));
    if (towards.length() < 0.05) towards.set(this.up.y, this.up.z, this.up.x);
    towards.normalize().addScaledVector(this.up, 0.42).normalize();
    const right = new THREE.Vector3().crossVectors(this.up, towards).normalize();
    return [right, new THREE.Vector3().crossVectors(towards, right), towards];
  }

  drawFace(pen, face, left, width, height) {
    const [columns, rows] = face.entry.mesh;
    const frame = this.frame(face.entry.normal);
    const { position, normal } = face.mesh.geometry.attributes;
    const count = columns * rows;
    const seen = [0, 1, 2].map(() => new Float64Array(count));
    const bright = new Float64Array(count);
    const from = new THREE.Vector3();
    for (let k = 0; k < count; k++) {
      from.fromBufferAttribute(position, k);
      frame.forEach((axis, c) => { seen[c][k] = from.dot(axis); });
      from.fromBufferAttribute(normal, k);
      const light = Math.abs(frame.reduce((sum, axis, c) => sum + from.dot(axis) * LIGHT.getComponent(c), 0));
      bright[k] = 1 - SHADE + SHADE * light;
    }
    const patches = [];
    for (let i = 0; i + 1 < columns; i++) {
      for (let j = 0; j + 1 < rows; j++) {
        const place = face.indexAt({ x: (i + 0.5) / (columns - 1), y: (j + 0.5) / (rows - 1) });
        if (face.inside[place] <= 127) continue;
        const k = i * rows + j;
        const at = 4 * ((place % face.rows) * face.columns + Math.floor(place / face.rows));
        patches.push({ corners: [k, k + rows, k + rows + 1, k + 1], depth: seen[2][k], at, k });
      }
    }
    const range = (values) => {
      const some = patches.flatMap(({ corners }) => corners.map((k) => values[k]));
      return some.reduce(([low, high], value) => [Math.min(low, value), Math.max(high, value)], [Infinity, -Infinity]);
    };
    const [[x0, x1], [y0, y1]] = [range(seen[0]), range(seen[1])];
    const size = Math.min((width - 2 * MARGIN) / (x1 - x0 || 1), (height - 2 * MARGIN) / (y1 - y0 || 1));
    const x = (k) => left + width / 2 + size * (seen[0][k] - (x0 + x1) / 2);
    const y = (k) => height / 2 - size * (seen[1][k] - (y0 + y1) / 2);
    // What is nearer is drawn later, over what it hides.
    patches.sort((a, b) => a.depth - b.depth);
    for (const { corners, at, k } of patches) {
      const colour = [0, 1, 2].map((c) => Math.round(face.pixels[at + c] * bright[k]));
      // Its border too, so that nothing shines through between two of them.
      pen.fillStyle = pen.strokeStyle = `rgb(${colour.join(" ")})`;
      pen.beginPath();
      corners.forEach((corner, n) => pen[n ? "lineTo" : "moveTo"](x(corner), y(corner)));
      pen.closePath();
      pen.fill();
      pen.stroke();
    }
  }
}
