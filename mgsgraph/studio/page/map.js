// The map: outlines of the images, points one by one or in cells, vectors, ellipses, relief. What was drawn last follows
// the hand at once (a picture that is moved and scaled); when the hand rests, it is drawn anew from the server's answer.

import {ask} from './app.js';
import {MapPicture} from './map_picture.js';
import {MapSelection} from './map_selection.js';
import {download, make, short} from './plot.js';

const LAYERS = [
  ['footprints', 'Outlines', true], ['points', 'Points', true], ['ellipses', 'Error ellipses (95 %)', false],
  ['moved', 'Corrections', false], ['changes', 'Last change', true], ['residuals', 'Residuals of an image', false],
  ['sigmas', 'Sigmas of new points', false], ['relief', 'Relief', false], ['candidates', 'What to measure next', true],
];
const REST = 120; // ms after the last movement before it is drawn anew
const MARGIN = 0.25; // of the window, drawn on each side beside it
const NEAR = 12; // CSS pixels around a mark that belong to it

export class MapPanel {
  constructor(app, element) {
    Object.assign(this, {app, element, shown: {}, view: null, points: null, layers: {}, drawn: null, hidden: new Set()});
    this.picture = new MapPicture(this);
    this.selection = new MapSelection(this);
    this.statistics = {frames: 0, draws: 0};
    this.build();
    app.addEventListener('opened', () => this.open());
    app.addEventListener('changed', event => this.changed(event.detail));
    app.addEventListener('renewed', () => { this.layers = {}; this.readOutlines(); this.ask(); });
    app.addEventListener('selected', () => this.selection.mark());
    app.addEventListener('candidates', event => { this.candidates = event.detail; this.render(); });
    app.addEventListener('shown', event => { if (event.detail === 'map') { this.fit(); this.ask(); } });
    if (app.scene) this.open();
  }

  // --- its parts

  build() {
    const tools = make('div', {className: 'tools'});
    this.value = make('select', {title: 'What points are colored by'});
    this.value.addEventListener('change', () => this.ask());
    tools.append(make('label', {}, 'Color ', this.value));
    this.classBox = make('fieldset', {}, make('legend', {textContent: 'Points'}));
    const layers = make('fieldset', {}, make('legend', {textContent: 'Layers'}));
    for (const [key, words, on] of LAYERS) {
      this.shown[key] = on;
      const box = make('input', {type: 'checkbox', checked: on, id: `layer-${key}`});
      box.addEventListener('change', () => { this.shown[key] = box.checked; this.ask(); });
      layers.append(make('label', {}, box, words));
    }
    this.image = make('select', {title: 'Image whose residuals are drawn'});
    this.image.addEventListener('change', () => this.ask());
    this.factor = make('input', {type: 'number', min: 0.01, step: 'any', value: 0, title: 'Enlargement of vectors and ellipses; 0: by itself'});
    this.factor.addEventListener('input', () => this.render());
    const drawn = make('details', {open: window.innerWidth >= 1000}, make('summary', {textContent: 'What is drawn'}),
      make('div', {className: 'tools'}, this.classBox, layers, make('label', {}, 'Residuals of ', this.image),
        make('label', {}, 'Vectors × (0: automatic) ', this.factor)));
    const button = (words, title, act) => {
      const one = make('button', {type: 'button', textContent: words, title});
      one.addEventListener('click', act);
      tools.append(one);
      return one;
    };
    button('+', 'Zoom in', () => this.zoom(1.5));
    button('−', 'Zoom out', () => this.zoom(1 / 1.5));
    button('Whole block', 'Key 0', () => this.whole());
    this.boxing = button('Select in a box', 'Then drag a box; or drag with the Shift key', () => this.toggleBox());
    button('Select in window', 'Key b', () => this.selection.inside(this.box()));
    tools.append(this.selection.form, this.saveMenu());
    this.canvas = make('canvas', {className: 'map-canvas', tabIndex: 0});
    this.canvas.setAttribute('role', 'application');
    this.canvas.setAttribute('aria-label', 'Map of the block: arrow keys move, plus and minus zoom, 0 shows all, c selects the point nearest to the middle, b all points in the window');
    this.legend = make('div');
    this.where = make('p', {className: 'caption'});
    this.words = make('p', {className: 'caption'});
    this.impact = make('div');
    const side = make('div', {className: 'map-side'}, this.legend, drawn, this.where, this.words, this.impact, this.selection.words, this.selection.names);
    this.element.replaceChildren(tools, make('div', {className: 'map'}, make('div', {className: 'map-view'}, this.canvas), side));
    this.hear();
  }

  saveMenu() {
    const menu = make('select', {title: 'Save this view as a figure with its caption'});
    for (const [value, words] of [['', 'Save figure …'], ['svg', 'SVG'], ['png', 'PNG'], ['pdf', 'PDF']])
      menu.append(make('option', {value, textContent: words}));
    menu.addEventListener('change', () => {
      const kind = menu.value;
      menu.value = '';
      if (!kind) return;
      const asked = this.asked(), layers = LAYERS.map(([key]) => key).filter(key => this.shown[key]);
      asked.set('layers', layers.join(','));
      asked.set('factor', this.factor.value || 0);
      asked.set('kind', kind);
      download(`/api/map/figure?${asked}`, `map.${kind}`).catch(error => this.app.say(error.message, 'error'));
    });
    return menu;
  }

  hear() {
    const {canvas} = this;
    new ResizeObserver(() => this.fit()).observe(canvas);
    canvas.addEventListener('wheel', event => {
      event.preventDefault();
      this.zoom(Math.exp(-0.0015 * event.deltaY), this.at(event));
    }, {passive: false});
    let from = null, moved = false;
    canvas.addEventListener('pointerdown', event => {
      if (event.button) return;
      canvas.setPointerCapture(event.pointerId);
      from = this.at(event);
      moved = false;
      if (event.shiftKey || this.boxMode) this.rubber = [from, from];
    });
    canvas.addEventListener('pointermove', event => {
      const now = this.at(event);
      if (!from) return this.point(now);
      moved ||= Math.hypot(now[0] - from[0], now[1] - from[1]) > 3;
      if (this.rubber) this.rubber[1] = now;
      else {
        this.move(from[0] - now[0], now[1] - from[1]);
        from = now;
      }
      this.draw();
      return undefined;
    });
    const release = event => {
      if (!from) return;
      const {rubber} = this, at = this.at(event);
      from = this.rubber = null;
      if (rubber && moved) {
        const [a, b] = rubber.map(one => this.toGround(one));
        this.selection.inside([Math.min(a[0], b[0]), Math.min(a[1], b[1]), Math.max(a[0], b[0]), Math.max(a[1], b[1])]);
      } else if (!moved) this.pick(at);
      this.draw();
    };
    canvas.addEventListener('pointerup', release);
    canvas.addEventListener('pointercancel', release);
    canvas.addEventListener('keydown', event => {
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      const act = {
        ArrowLeft: () => this.move(-60, 0), ArrowRight: () => this.move(60, 0), ArrowUp: () => this.move(0, 60),
        ArrowDown: () => this.move(0, -60), '+': () => this.zoom(1.5), '=': () => this.zoom(1.5), '-': () => this.zoom(1 / 1.5),
        0: () => this.whole(), c: () => this.pick([canvas.clientWidth / 2, canvas.clientHeight / 2], Infinity),
        b: () => this.selection.inside(this.box()), Escape: () => { this.boxMode = true; this.toggleBox(); },
      }[event.key];
      if (!act) return;
      event.preventDefault();
      event.stopPropagation();
      act();
    });
  }

  // --- window: view = {x, y: m in its middle; scale: CSS pixels a metre}

  at(event) {
    const box = this.canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  }

  toGround([x, y], view = this.view) {
    return [view.x + (x - this.canvas.clientWidth / 2) / view.scale, view.y - (y - this.canvas.clientHeight / 2) / view.scale];
  }

  box(margin = 0) {
    const {clientWidth: w, clientHeight: h} = this.canvas, {x, y, scale} = this.view;
    const across = (0.5 + margin) * w / scale, up = (0.5 + margin) * h / scale;
    return [x - across, y - up, x + across, y + up];
  }

  fit() {
    const {canvas} = this, density = window.devicePixelRatio || 1;
    if (!canvas.clientWidth) return;
    const size = [Math.round(canvas.clientWidth * density), Math.round(canvas.clientHeight * density)];
    if (canvas.width === size[0] && canvas.height === size[1] && this.view) return;
    [canvas.width, canvas.height] = size;
    if (!this.app.scene) return;
    if (!this.view) this.whole();
    else this.ask();
  }

  whole() {
    const {clientWidth: w, clientHeight: h} = this.canvas;
    if (!w) return;
    let [x0, y0, x1, y1] = this.app.scene.map.bounds_m;
    for (const [x, y] of (this.outlines || []).flat()) [x0, y0, x1, y1] = [Math.min(x0, x), Math.min(y0, y), Math.max(x1, x), Math.max(y1, y)];
    this.touchedOnce = false;
    this.view = {x: (x0 + x1) / 2, y: (y0 + y1) / 2, scale: 0.92 * Math.min(w / Math.max(x1 - x0, 1), h / Math.max(y1 - y0, 1))};
    this.ask();
  }

  move(right, up) {
    this.view.x += right / this.view.scale;
    this.view.y += up / this.view.scale;
    this.touched();
  }

  zoom(factor, about = [this.canvas.clientWidth / 2, this.canvas.clientHeight / 2]) {
    const before = this.toGround(about);
    this.view.scale = Math.min(Math.max(this.view.scale * factor, 1e-7), 1e3);
    const after = this.toGround(about);
    this.view.x += before[0] - after[0];
    this.view.y += before[1] - after[1];
    this.touched();
  }

  touched() {
    this.touchedOnce = true;
    this.draw();
    clearTimeout(this.rest);
    this.rest = setTimeout(() => this.ask(), REST);
  }

  // --- what the server is asked

  open() {
    const {scene} = this.app;
    this.value.replaceChildren(...scene.values.map(one => make('option', {value: one.name, textContent: `${one.title} (${one.unit})`})));
    this.value.value = scene.adjusted ? 'sigma' : 'rays';
    this.image.replaceChildren(...scene.images.map(one => make('option', {value: one.name, textContent: one.name})));
    this.classBox.querySelectorAll('label').forEach(one => one.remove());
    for (const {name, count} of scene.classes) {
      if (!count) continue;
      const box = make('input', {type: 'checkbox', checked: true});
      box.addEventListener('change', () => {
        box.checked ? this.hidden.delete(name) : this.hidden.add(name);
        this.ask();
      });
      this.classBox.append(make('label', {}, box, `${name} (${count})`));
    }
    document.getElementById('layer-relief').disabled = !scene.terrain;
    if (scene.terrain && !this.view) {
      this.shown.relief = true;
      document.getElementById('layer-relief').checked = true;
    }
    this.words.textContent = `Map in ${scene.map.frame}.`;
    this.fit();
    if (this.view && this.drawn === null) this.whole();
    this.readOutlines();
  }

  changed(found) {
    const list = make('ul', {className: 'moved-list'});
    for (const one of (found.moved || []).slice(0, 8)) {
      const words = one.sigmas === null ? 'new' : `${short(Math.hypot(...one.vector_m))} m, ${short(one.sigmas)} of its sigmas`;
      list.append(make('li', {textContent: `${one.name}: ${words}`}));
    }
    this.impact.replaceChildren(make('h2', {textContent: 'What the last change did'}),
      make('p', {className: 'caption', textContent: found.sentences.join(' ')}), list);
    this.render();
  }

  asked(margin = 0) {
    const [x0, y0, x1, y1] = this.box(margin), share = 1 + 2 * margin;
    const classes = this.app.scene.classes.map(one => one.name).filter(name => !this.hidden.has(name)).join(',');
    return new URLSearchParams({
      x0, y0, x1, y1, w: Math.round(share * this.canvas.clientWidth), h: Math.round(share * this.canvas.clientHeight),
      value: this.value.value, classes,
    });
  }

  // One round of questions at a time; the last window that was wanted comes next
  async ask() {
    if (!this.view || !this.canvas.clientWidth || this.element.hidden) return;
    this.render();
    if (this.asking) {
      this.again = true;
      return;
    }
    this.asking = true;
    try {
      do {
        this.again = false;
        await this.read();
        this.render();
      } while (this.again);
    } catch (error) {
      this.app.say(error.message, 'error');
    } finally {
      this.asking = false;
      this.element.dataset.ready = 'true';
    }
  }

  async read() {
    const asked = this.asked(MARGIN), box = this.box(MARGIN), {shown, layers} = this;
    const wanted = [];
    if (shown.points || shown.ellipses || shown.moved)
      wanted.push(this.app.request(`/api/map/points?${asked}`).then(found => { this.points = found; }));
    if (shown.relief && this.app.scene.terrain) wanted.push(this.readRelief(asked, box));
    if (shown.sigmas && !layers.sigmas)
      wanted.push(this.app.request('/api/map/sigmas').then(found => { layers.sigmas = found; }, error => this.refused('sigmas', error)));
    if (shown.residuals && layers.residuals?.image !== this.image.value)
      wanted.push(this.app.request(`/api/map/residuals?${new URLSearchParams({image: this.image.value})}`).then(found => { layers.residuals = found; }));
    await Promise.all(wanted);
    this.legend.replaceChildren(...this.picture.legend());
  }

  refused(layer, error) {
    this.shown[layer] = false;
    document.getElementById(`layer-${layer}`).checked = false;
    this.app.say(error.message, 'error');
  }

  // They come after the points, for it takes longer to find them; the window holds them then, unless it was moved meanwhile
  async readOutlines() {
    const found = await this.app.request('/api/map/outlines').catch(error => this.app.say(error.message, 'error'));
    if (!found) return;
    const first = !this.outlines;
    this.outlines = found.outlines_m;
    if (first && this.view && !this.touchedOnce) this.whole();
    else this.render();
    this.element.dataset.outlines = 'true';
  }

  async readRelief(asked, box) {
    const answer = await ask(`/api/map/relief.png?${asked}`);
    this.layers.relief = {box, picture: await createImageBitmap(await answer.blob())};
  }

  // --- drawing

  // What was drawn, moved to where the window is now; then what must be sharp
  draw() {
    if (this.pending) return;
    this.pending = true;
    requestAnimationFrame(() => {
      this.pending = false;
      this.statistics.frames += 1;
      this.show();
    });
  }

  show() {
    const {canvas, view, drawn} = this;
    if (!view || !canvas.clientWidth) return;
    const density = window.devicePixelRatio || 1, context = canvas.getContext('2d');
    const [w, h] = [canvas.clientWidth, canvas.clientHeight];
    context.setTransform(density, 0, 0, density, 0, 0);
    context.clearRect(0, 0, w, h);
    if (drawn) {
      const share = view.scale / drawn.view.scale, wide = drawn.width * share, high = drawn.height * share;
      const x = w / 2 + (drawn.view.x - view.x) * view.scale - wide / 2, y = h / 2 - (drawn.view.y - view.y) * view.scale - high / 2;
      context.drawImage(drawn.picture, x, y, wide, high);
    }
    this.picture.drawScaleBar(context, w, h);
    if (this.rubber) {
      const [[x0, y0], [x1, y1]] = this.rubber;
      context.strokeStyle = getComputedStyle(canvas).color;
      context.setLineDash([5, 4]);
      context.strokeRect(Math.min(x0, x1), Math.min(y0, y1), Math.abs(x1 - x0), Math.abs(y1 - y0));
      context.setLineDash([]);
    }
  }

  // Everything anew, on a picture of the window and a margin around it
  render() {
    const {canvas, view} = this;
    if (!view || !canvas.clientWidth) return;
    this.statistics.draws += 1;
    const density = window.devicePixelRatio || 1, share = 1 + 2 * MARGIN;
    const width = share * canvas.clientWidth, height = share * canvas.clientHeight;
    const picture = this.spare || document.createElement('canvas');
    this.spare = this.drawn?.picture;
    picture.width = Math.round(width * density);
    picture.height = Math.round(height * density);
    const context = picture.getContext('2d');
    context.setTransform(density, 0, 0, density, 0, 0);
    const style = getComputedStyle(canvas);
    const x = one => width / 2 + (one - view.x) * view.scale, y = one => height / 2 - (one - view.y) * view.scale;
    const pen = {context, x, y, width, height, ink: style.color, moved: style.getPropertyValue('--moved'), strong: style.getPropertyValue('--strong')};
    context.font = `12px ${style.fontFamily}`;
    this.picture.draw(pen);
    this.drawn = {picture, view: {...view}, width, height};
    this.show();
  }

  // --- places and selections

  point(at) {
    const [east, north] = this.toGround(at), place = `${short(east, 6)} m east, ${short(north, 6)} m north`;
    this.where.textContent = place;
    clearTimeout(this.wondering);
    this.wondering = setTimeout(async () => {
      const found = await this.app.request(`/api/map/where?${new URLSearchParams({x: east, y: north})}`).catch(() => null);
      if (found) this.where.textContent = `${place}: longitude ${found.longitude_deg.toFixed(5)}° E, latitude ${found.latitude_deg.toFixed(5)}° (planetocentric)`;
    }, 120);
  }

  placeOf(name) {
    if (!name) return null;
    let k = this.points?.names?.indexOf(name) ?? -1;
    if (k >= 0) return [this.points.x[k], this.points.y[k]];
    k = this.selection.found?.names.indexOf(name) ?? -1;
    return k >= 0 ? this.selection.found.places[k] : null;
  }

  pick(at, near = NEAR) {
    if (this.points?.form !== 'points') return this.app.say('Zoom in until points are drawn one by one, then click one; or select in a box.');
    const [east, north] = this.toGround(at);
    let best = -1, least = near / this.view.scale;
    this.points.x.forEach((one, k) => {
      const distance = Math.hypot(one - east, this.points.y[k] - north);
      if (distance <= least) [best, least] = [k, distance];
    });
    if (best >= 0) this.app.select(this.points.names[best]);
    return undefined;
  }

  toggleBox() {
    this.boxMode = !this.boxMode;
    this.boxing.setAttribute('aria-pressed', String(this.boxMode));
    this.canvas.classList.toggle('boxing', this.boxMode);
  }
}

export function panel(app, element) {
  element.view = new MapPanel(app, element);
  return element.view;
}
