// Widgets of the theory pages. They draw numbers that python -m benchmarks.widgets computed: no server, no network.
(() => {
  const WIDTH = 640;
  const HEIGHT = 260;
  const EDGE = { left: 58, right: 14, top: 12, bottom: 40 };
  const WINDOWS = [3, 5, 10, 20, 50];
  const SVG = "http://www.w3.org/2000/svg";
  const source = new URL("widget-data.js", document.currentScript.src);

  const make = (name, attributes = {}, text = "") => {
    const element = document.createElementNS(SVG, name);
    for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
    element.textContent = text;
    return element;
  };

  const short = (value) => (Math.abs(value) < 1e-9 ? "0" : String(Number(Number(value).toPrecision(3))));

  // a plot with axes: scales [low, high, is logarithmic], and functions that map values to pixels
  class Plot {
    constructor(host, label) {
      this.svg = make("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "img", "aria-label": label });
      host.append(this.svg);
    }
    axes(x, y, x_title, y_title) {
      this.svg.replaceChildren();
      this.x = this.scale(x, EDGE.left, WIDTH - EDGE.right);
      this.y = this.scale(y, HEIGHT - EDGE.bottom, EDGE.top);
      for (const value of ticks(x)) {
        this.line([[this.x(value), EDGE.top], [this.x(value), HEIGHT - EDGE.bottom]], "grid");
        this.text(this.x(value), HEIGHT - EDGE.bottom + 16, short(value), "middle");
      }
      for (const value of ticks(y)) {
        this.line([[EDGE.left, this.y(value)], [WIDTH - EDGE.right, this.y(value)]], "grid");
        this.text(EDGE.left - 6, this.y(value) + 4, short(value), "end");
      }
      this.text((EDGE.left + WIDTH - EDGE.right) / 2, HEIGHT - 6, x_title, "middle");
      const title = make("text", { transform: `translate(13 ${(EDGE.top + HEIGHT - EDGE.bottom) / 2}) rotate(-90)` }, y_title);
      title.setAttribute("text-anchor", "middle");
      this.svg.append(title);
    }
    scale([low, high, is_log], start, end) {
      const form = is_log ? Math.log10 : (value) => value;
      const map = (value) => start + ((form(value) - form(low)) / (form(high) - form(low))) * (end - start);
      return (value) => Math.min(Math.max(map(value), Math.min(start, end)), Math.max(start, end));
    }
    text(x, y, text, anchor) {
      this.svg.append(make("text", { x, y, "text-anchor": anchor }, text));
    }
    line(points, kind) {
      const path = points.map((point, number) => `${number ? "L" : "M"}${point[0].toFixed(1)} ${point[1].toFixed(1)}`);
      this.svg.append(make("path", { d: path.join(""), class: kind }));
    }
    curve(xs, ys, kind) {
      const points = [];
      xs.forEach((x, number) => ys[number] !== null && points.push([this.x(x), this.y(ys[number])]));
      this.line(points, kind);
    }
    dot(x, y, kind, radius = 4) {
      this.svg.append(make("circle", { cx: this.x(x), cy: this.y(y), r: radius, class: kind }));
    }
  }

  function ticks([low, high, is_log]) {
    if (is_log) {
      const first = Math.ceil(Math.log10(low) - 1e-9);
      const last = Math.floor(Math.log10(high) + 1e-9);
      return Array.from({ length: last - first + 1 }, (_, number) => 10 ** (first + number));
    }
    const rough = (high - low) / 5;
    const power = 10 ** Math.floor(Math.log10(rough));
    const step = power * [1, 2, 5, 10].find((factor) => factor * power >= rough);
    const result = [];
    for (let value = Math.ceil(low / step) * step; value <= high + 1e-9; value += step) {
      result.push(Math.abs(value) < step / 1e6 ? 0 : value);
    }
    return result;
  }

  let count = 0;
  // a labelled slider over the entries of a list
  function slider(host, title, values, start, show, on_change) {
    const id = `widget-${(count += 1)}`;
    const label = document.createElement("label");
    const input = document.createElement("input");
    const shown = document.createElement("output");
    label.htmlFor = input.id = id;
    shown.htmlFor = id;
    label.textContent = title;
    Object.assign(input, { type: "range", min: 0, max: values.length - 1, step: 1, value: values.indexOf(start) });
    const update = () => {
      shown.textContent = show(values[input.value]);
      input.setAttribute("aria-valuetext", shown.textContent);
      on_change();
    };
    input.addEventListener("input", update);
    shown.textContent = show(start);
    input.setAttribute("aria-valuetext", shown.textContent);
    host.append(label, input, shown);
    return { get value() { return values[input.value]; }, set index(number) { input.value = number; update(); } };
  }

  function frame(host, label) {
    const controls = document.createElement("div");
    controls.className = "tarc-widget-controls";
    const words = document.createElement("p");
    words.setAttribute("aria-live", "polite");
    host.replaceChildren(controls);
    const plot = new Plot(host, label);
    host.append(words);
    return { controls, plot, words };
  }

  const kinds = (value) => (value ? "synchronised" : "literal");
  const degrees = (value) => `${value}`;
  const periods = (value) => `${value} periods`;

  function kernel(host, data) {
    const { controls, plot, words } = frame(host, "Weights of the samples in the window, and the kernel");
    const draw = () => {
      const order = Math.min(derivative.value, degree.value);
      const N = size.value;
      const found = data.estimators[`${N}/${degree.value}/${order}`];
      const times = Array.from({ length: N + 1 }, (_, number) => -number);
      const places = found.kernel.map((_, number) => (-N * number) / (found.kernel.length - 1));
      const top = 1.1 * Math.max(...found.weights.map(Math.abs), ...found.kernel.map(Math.abs));
      plot.axes([-N, 0], [-top, top], "age of the sample [periods of 1 ms]", order === 1 ? "weight [1/s]" : "weight [1/s²]");
      plot.curve(places, found.kernel, "second");
      plot.line([[plot.x(-N), plot.y(0)], [plot.x(0), plot.y(0)]], "axis");
      times.forEach((time, number) => {
        plot.line([[plot.x(time), plot.y(0)], [plot.x(time), plot.y(found.weights[number])]], "first");
        plot.dot(time, found.weights[number], "first-dot", N > 25 ? 2 : 3.5);
      });
      words.textContent =
        `${order === 1 ? "Velocity" : "Acceleration"}: delay ${short(found.delay)} ms, ` +
        `noise gain ${short(found.noise)} ${order === 1 ? "1/s" : "1/s²"}. ` +
        "Dots: weights that the law uses. Line: the kernel, which they approach in long windows.";
    };
    const size = slider(controls, "Window", WINDOWS, 10, periods, () => draw());
    const degree = slider(controls, "Degree", [1, 2, 3], 2, degrees, () => draw());
    const derivative = slider(controls, "Derivative", [1, 2], 1, (value) => ["velocity", "acceleration"][value - 1], () => draw());
    draw();
  }

  function windows(host, data) {
    const { controls, plot, words } = frame(host, "Gain of the estimated velocity and acceleration over frequency");
    const draw = () => {
      plot.axes([10, 3000, true], [0.01, 10, true], "frequency [rad/s]", "gain / ideal");
      plot.line([[plot.x(10), plot.y(1)], [plot.x(3000), plot.y(1)]], "axis");
      const key = `${size.value}/${degree.value}`;
      const velocity = data.estimators[`${key}/1`];
      const acceleration = data.estimators[`${key}/2`];
      plot.curve(data.frequencies, velocity.gain, "first");
      if (acceleration) plot.curve(data.frequencies, acceleration.gain, "second");
      words.textContent =
        `Solid, velocity: delay ${short(velocity.delay)} ms, noise gain ${short(velocity.noise)} 1/s. ` +
        (acceleration
          ? `Dashed, acceleration: delay ${short(acceleration.delay)} ms, noise gain ${short(acceleration.noise)} 1/s².`
          : "A line has no acceleration.");
    };
    const size = slider(controls, "Window", WINDOWS, 10, periods, () => draw());
    const degree = slider(controls, "Degree", [1, 2, 3], 2, degrees, () => draw());
    draw();
  }

  function ratio(host, data) {
    const { controls, plot, words } = frame(host, "Error of a joint after a start 0.1 rad beside its reference");
    const draw = () => {
      const found = data.responses[`${size.value}/${kind.value}`];
      const errors = found.errors[data.ratios.indexOf(rho.value)];
      const times = errors.map((_, number) => (data.response_time * number) / (errors.length - 1));
      const [low, high] = found.interval;
      const is_stable = rho.value > low && rho.value < high;
      const end = errors.includes(null) ? errors.indexOf(null) : errors.length;
      plot.axes([0, data.response_time], [-0.2, 0.2], "time [s]", "error [rad]");
      plot.line([[plot.x(0), plot.y(0)], [plot.x(data.response_time), plot.y(0)]], "axis");
      plot.curve(times.slice(0, end), errors.slice(0, end), is_stable ? "good" : "bad");
      words.textContent =
        `Ratio M̂/M = ${short(rho.value)}: ${is_stable ? "stable" : "unstable"}. ` +
        `The loop is stable from ${short(low)} to ${short(high)}.`;
    };
    const size = slider(controls, "Window", [5, 10, 20], 10, periods, () => draw());
    const kind = slider(controls, "Estimation", [0, 1], 0, kinds, () => draw());
    const middle = data.ratios.find((value) => value > 0.08);
    const rho = slider(controls, "Inertia ratio", data.ratios, middle, short, () => draw());
    draw();
  }

  function map(host, data) {
    const { controls, plot, words } = frame(host, "Stable inertia ratios over the natural frequency");
    const xs = data.natural_frequencies;
    const draw = () => {
      const found = data.maps[`${size.value}/${kind.value}`];
      plot.axes([2, 100, true], [0.001, 4, true], "natural frequency [rad/s]", "inertia ratio");
      const there = xs.map((_, number) => number).filter((number) => found.low[number] !== null);
      const upper = there.map((number) => [plot.x(xs[number]), plot.y(found.high[number])]);
      const lower = there.map((number) => [plot.x(xs[number]), plot.y(found.low[number])]);
      if (there.length) plot.line([...upper, ...lower.reverse(), upper[0]], "area");
      const number = xs.indexOf(frequency.value);
      const [low, high] = [found.low[number], found.high[number]];
      const is_stable = low !== null && rho.value > low && rho.value < high;
      plot.dot(frequency.value, rho.value, is_stable ? "good-dot" : "bad-dot", 7);
      words.textContent =
        `${short(frequency.value)} rad/s, ratio ${short(rho.value)}: ${is_stable ? "stable" : "unstable"}. ` +
        (low === null ? "No ratio is stable here." : `Stable from ${short(low)} to ${short(high)}, if the ratio is constant.`);
    };
    const size = slider(controls, "Window", WINDOWS, 10, periods, () => draw());
    const kind = slider(controls, "Estimation", [0, 1], 0, kinds, () => draw());
    const frequency = slider(controls, "Natural frequency", xs, xs[8], (value) => `${short(value)} rad/s`, () => draw());
    const rho = slider(controls, "Inertia ratio", data.ratios, data.ratios.find((value) => value > 0.08), short, () => draw());
    draw();
  }

  const builders = { kernel, window: windows, ratio, map };
  const build = () => {
    for (const host of document.querySelectorAll(".tarc-widget")) builders[host.dataset.widget](host, window.tarcWidgetData);
  };
  const load = () => {
    if (!document.querySelector(".tarc-widget")) return;
    const script = document.createElement("script");
    script.src = source.href;
    script.onload = build;
    document.head.appendChild(script);
  };
  if (document.readyState === "loading") document.addEventListener("DOMContentLoaded", load);
  else load();
})();
