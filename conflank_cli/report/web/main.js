// The report: what is in the page's data, on the screen.

import { Charts } from "./charts.js";
import { readReport } from "./data.js";
import { Motion } from "./motion.js";
import { Picture } from "./picture.js";
import { View } from "./scene.js";

const find = (selector) => document.querySelector(selector);
const all = (selector) => [...document.querySelectorAll(selector)];

function wire(report, arrays) {
  const motion = new Motion(report, arrays);
  const canvas = find("#view");
  let view = null;
  let picture = null;
  try {
    view = new View(canvas, report, arrays, motion);
  } catch {
    // Without WebGL there are still pictures, tables and charts. A canvas that was asked for WebGL gives nothing else.
    const still = find("#still");
    canvas.hidden = true;
    still.hidden = find("#no-view").hidden = false;
    find(".looks").hidden = true;
    all("#rest, aside [data-layer], [data-layer^='ruled:'], [data-all='ruled']").forEach((each) => { each.disabled = true; });
    picture = new Picture(still, report, arrays, motion);
  }
  const state = { index: 0, time: 0, playing: false, mode: "gap", rendered: 0, firstPicture: NaN };
  const slider = find("#pose");
  slider.max = String(Math.max(motion.count - 1, 0));
  slider.disabled = motion.count === 0;

  const lines = new Map();
  new TextDecoder().decode(arrays.text).split("\n").forEach((line, k) => {
    const numbered = line.match(/^\s*N?(\d+)\b/);
    const block = numbered ? Number(numbered[1]) : k + 1;
    if (!lines.has(block)) lines.set(block, line);
  });

  function cutName(cut) {
    return cut < 0 ? "between cuts" : report.cuts[cut].label;
  }

  const rows = all("tr[data-cut]");
  let told = null; // the cut whose row stands out

  function tell() {
    const pose = motion.pose(state.index);
    slider.value = String(state.index);
    slider.setAttribute("aria-valuetext", `block ${pose.block}, ${cutName(pose.cut)}, ${pose.time_s.toFixed(2)} s`);
    find("#block").textContent = lines.get(pose.block) ?? `block ${pose.block}`;
    find("#now").textContent = `${state.time.toFixed(2)} s of ${motion.duration.toFixed(1)} s · ${cutName(pose.cut)}`;
    charts.at(state.time);
    if (pose.cut === told) return;
    told = pose.cut;
    rows.forEach((row) => row.classList.toggle("current", Number(row.dataset.cut) === pose.cut));
  }

  function seek(index) {
    if (!motion.count) return;
    state.index = Math.min(Math.max(Math.round(index), 0), motion.count - 1);
    state.time = motion.time[state.index];
    const pose = motion.pose(state.index);
    view?.place(pose, pose.tool);
    tell();
  }

  function play(on) {
    state.playing = on && motion.count > 1;
    if (state.playing && state.index === motion.count - 1) seek(0);
    state.last = performance.now();
    find("#play").textContent = state.playing ? "Pause" : "Play";
    find("#play").setAttribute("aria-pressed", String(state.playing));
  }

  function step(now) {
    if (state.playing) {
      state.time += ((now - state.last) / 1000) * Number(find("#rate").value);
      state.last = now;
      if (state.time >= motion.duration) {
        play(false);
        seek(motion.count - 1);
      } else {
        const pose = motion.between(Math.max(state.time, 0));
        state.index = pose.index;
        const next = Math.min(pose.index + 1, motion.count - 1);
        view?.place(pose, motion.tool[next]);
        tell();
      }
    }
    if (repaint) paint();
    if (view?.render(now)) {
      state.rendered += 1;
      if (state.rendered === 1) state.firstPicture = performance.now();
    }
    requestAnimationFrame(step);
  }

  function shownCuts() {
    const shown = new Set(all("[data-layer^='patch:']").filter((box) => box.checked).map((box) => Number(box.dataset.layer.slice(6))));
    shown.all = shown.size === report.cuts.length;
    return shown;
  }

  // Painting waits for the next picture, so that a press on "all" paints once.
  let repaint = true;

  function paint() {
    repaint = false;
    view?.paint(state.mode, shownCuts(), find("[data-layer='uncovered']").checked);
    picture?.paint(state.mode, shownCuts());
    all("[data-legend]").forEach((legend) => { legend.hidden = legend.dataset.legend !== state.mode; });
    const reach = report.reach.find(({ key }) => key === state.mode);
    if (reach) {
      const legend = find("[data-legend='reach']");
      legend.hidden = false;
      legend.querySelector(".to").textContent = `${reach.limit_um}`;
    }
  }

  function apply(box) {
    const layer = box.dataset.layer;
    if (layer.startsWith("patch:") || layer === "uncovered") repaint = true;
    else if (layer === "holder") view?.showHolder(box.checked);
    else if (view) {
      view.layer(layer).visible = box.checked;
      view.dirty = true;
    }
  }

  const charts = new Charts(find("#charts"), motion, report, (time) => {
    play(false);
    seek(motion.at(Math.max(time, 0)));
  });
  all("[data-layer]").forEach((box) => {
    box.addEventListener("change", () => apply(box));
    apply(box);
  });
  all("[data-all]").forEach((box) =>
    box.addEventListener("change", () =>
      box.closest("section").querySelectorAll(`[data-layer^='${box.dataset.all}:']`).forEach((each) => {
        each.checked = box.checked;
        apply(each);
      }),
    ),
  );
  find("#rest").addEventListener("change", (event) => view?.rest(event.target.value));
  view?.rest(find("#rest").value);
  find("#mode").addEventListener("change", (event) => {
    state.mode = event.target.value;
    repaint = true;
  });
  slider.addEventListener("input", () => {
    play(false);
    seek(Number(slider.value));
  });
  find("#play").addEventListener("click", () => play(!state.playing));
  all("[data-look]").forEach((button) => button.addEventListener("click", () => view?.look(Number(button.dataset.look))));
  all("[data-seek]").forEach((button) =>
    button.addEventListener("click", () => {
      play(false);
      seek(Number(button.dataset.seek));
      const face = report.cuts.find((cut) => cut.first === Number(button.dataset.seek))?.face;
      const index = report.faces.findIndex(({ number }) => number === face);
      if (index >= 0) view?.look(index);
      find(".stage").scrollIntoView({ block: "nearest" });
    }),
  );
  all("[data-place]").forEach((button) =>
    button.addEventListener("click", () => {
      const place = report.places[Number(button.dataset.place)];
      play(false);
      if (place.pose !== null) seek(place.pose);
      find("[data-layer='places']").checked = true;
      apply(find("[data-layer='places']"));
      view?.goTo(place);
      all("[data-place]").forEach((each) => each.toggleAttribute("aria-current", each === button));
      find(".stage").scrollIntoView({ block: "nearest" });
    }),
  );
  if (view) {
    canvas.addEventListener("keydown", (event) => {
      if (view.key(event)) event.preventDefault();
    });
    canvas.addEventListener("pointermove", (event) => {
      const box = canvas.getBoundingClientRect();
      const hit = event.buttons ? null : view.under(
        (2 * (event.clientX - box.left)) / box.width - 1, 1 - (2 * (event.clientY - box.top)) / box.height,
      );
      let text = "";
      if (hit) {
        const { gap, cut } = hit.face.value(hit.k, shownCuts());
        const amount = Number.isFinite(gap) ? `${gap > 0 ? "+" : ""}${gap.toFixed(1)} µm` : `more than ${report.far_um} µm of stock`;
        text = `face ${hit.face.entry.number}: ${amount}${cut >= 0 && Number.isFinite(gap) ? `, ${cutName(cut)}` : ""}`;
      }
      find("#under").textContent = text;
    });
    new ResizeObserver(() => view.resize()).observe(canvas);
    view.resize();
    view.look(0);
  }

  function theme() {
    picture?.draw();
    view?.background(getComputedStyle(document.documentElement).getPropertyValue("--stage").trim());
    charts.draw();
  }
  const dark = window.matchMedia("(prefers-color-scheme: dark)");
  dark.addEventListener("change", theme);
  find("#theme").addEventListener("click", () => {
    const root = document.documentElement;
    const isDark = root.dataset.theme ? root.dataset.theme === "dark" : dark.matches;
    root.dataset.theme = isDark ? "light" : "dark";
    theme();
  });
  theme();
  seek(report.start);
  requestAnimationFrame(step);

  // What a test or a script can ask of the page.
  return {
    count: motion.count,
    pose: (i) => motion.pose(i),
    seek,
    index: () => state.index,
    cutter: () => view?.cutters.flatMap((group) => (group.visible ? [[...group.position.toArray(), ...group.quaternion.toArray()]] : []))[0] ?? null,
    play: () => play(true),
    pause: () => play(false),
    playing: () => state.playing,
    show: (layer, on) => {
      const box = find(`[data-layer='${layer}']`);
      box.checked = on;
      box.dispatchEvent(new Event("change"));
    },
    visible: (layer) => view?.layers.get(layer)?.visible ?? null,
    colours: (face) => Array.from((view ?? picture).faces[face].pixels),
    moves: () => view !== null,
    pictures: () => state.rendered,
    firstPicture: () => state.firstPicture,
  };
}

window.conflank = {
  ready: readReport()
    .then(({ report, arrays }) => {
      Object.assign(window.conflank, wire(report, arrays));
      document.body.dataset.state = "ready";
    })
    .catch((error) => {
      find("#failure").hidden = false;
      find("#failure").textContent = `This browser cannot show the report: ${error.message}`;
      throw error;
    }),
};
