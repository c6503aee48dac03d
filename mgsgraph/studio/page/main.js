// The page: its tabs and keys. Each panel is a module with a class Panel; app.views has one of it from when it is first
// shown, which hears of what happens by the app's events.

import {App, withModifier} from './app.js';
import {button, make} from './plot.js';
import {difference} from './questions.js';
import {Verdict} from './verdict.js';
import {Work} from './work.js';

const PANELS = [
  ['start', 'Start', '1', './start.js'],
  ['map', 'Map', '2', './map.js'],
  ['images', 'Images', '3', './images.js'],
  ['lists', 'Lists', '4', './lists.js'],
  ['point', 'Point', '5', './sheet.js'],
  ['questions', 'Questions', '6', './questions.js'],
];
const KEYS = {
  Everywhere: [
    ['1 … 6', 'the views'], ['u, U', 'undo, redo a change of the project'], ['d', 'height difference of the last two selected points'],
    ['v', 'verdict and its reasons'], ['?', 'these keys'], ['Escape', 'close what is open']],
  Map: [
    ['arrows, + −, 0', 'move, zoom, whole block'], ['c', 'select the point nearest to the middle'], ['b', 'select the points in the window'],
    ['Shift + drag', 'select the points in a box'], ['d', 'distance: click two points or positions, or Enter at the middle']],
  Images: [
    ['arrows, + −, 0', 'move, zoom, whole image'], ['Tab', 'to the next tool, then the next image'], ['n, p', 'next, previous tie by the size of its residual'],
    ['m', 'measure a point'], ['Enter', 'select or measure at the cross'], ['t', 'lines along the pane, downwards, or north up'],
    ['b', 'two images in one pane: blink'], ['w, [ ]', 'swipe between them, move the handle'], ['a', 'both in red and cyan'],
    ['o', 'orientation before or after the adjustment']],
  Lists: [
    ['arrows, Page, Home, End', 'the active row'], ['Enter, Space', 'select, mark the active row'],
    ['r, a, u', 'reject, accept, undecided: marked rows or the active one']],
  Point: [['Enter', 'show the point of this name, store a position'], ['+ −', 'on a chip: zoom all chips'], ['Escape', 'cancel a move or a measurement']],
  Questions: [['Enter', 'ask the first question of the row']],
};

const byId = id => document.getElementById(id);
const app = new App(byId('say'));
app.work = new Work(app, byId('job'));
app.verdict = new Verdict(app, byId('verdict'));
window.studio = app; // for the browser's console and for tests
const tabs = new Map();

function build() {
  for (const [key, title, shortcut, module] of PANELS) {
    const tab = button(title, () => show(key), {id: `tab-${key}`, role: 'tab', title: `Key ${shortcut}`});
    tab.setAttribute('aria-controls', key);
    const element = make('section', {id: key, role: 'tabpanel', hidden: true});
    element.setAttribute('aria-labelledby', tab.id);
    tab.addEventListener('keydown', event => {
      const step = {ArrowRight: 1, ArrowLeft: -1}[event.key];
      if (!step) return;
      const order = [...tabs.keys()], next = order[(order.indexOf(key) + step + order.length) % order.length];
      show(next);
      tabs.get(next).tab.focus();
    });
    byId('tabs').append(tab);
    byId('content').append(element);
    tabs.set(key, {tab, element, module, made: null});
  }
}

async function show(key) {
  for (const [name, {tab, element}] of tabs) {
    tab.setAttribute('aria-selected', String(name === key));
    tab.tabIndex = name === key ? 0 : -1;
    element.hidden = name !== key;
  }
  const one = tabs.get(key);
  one.made ??= opening.then(() => import(one.module)).then(({Panel}) => { app.views[key] = one.element.view = new Panel(app, one.element); });
  await one.made;
  app.emit('shown', key);
  if (document.activeElement === document.body) one.element.querySelector('[role=application]')?.focus({preventScroll: true}); // its keys
  return app.views[key];
}
app.show = show;

function typing(target) {
  return target.closest?.('input, select, textarea, [contenteditable]') !== null;
}

const DOING = {u: 'undo', U: 'redo', d: 'difference', v: 'verdict'}; // the button of a key

document.addEventListener('keydown', event => {
  if (withModifier(event) || typing(event.target)) return;
  const panel = PANELS.find(([, , shortcut]) => shortcut === event.key);
  if (panel) show(panel[0]);
  else if (event.key === '?') help();
  else if (DOING[event.key] && !byId(DOING[event.key]).disabled && !byId(DOING[event.key]).hidden) byId(DOING[event.key]).click();
  else return;
  event.preventDefault();
});

// A dialog with a heading; what had the focus gets it back
function open(dialog, title, ...parts) {
  dialog.replaceChildren(make('h2', {id: `${dialog.id}-title`, textContent: title}), ...parts, button('Close', () => dialog.close()));
  dialog.showModal();
}

function help() {
  const views = Object.entries(KEYS).map(([view, rows]) => make('section', {}, make('h3', {textContent: view}),
    make('table', {}, ...rows.map(([keys, words]) => make('tr', {}, make('td', {}, make('kbd', {textContent: keys})), make('td', {textContent: words}))))));
  open(byId('keys'), 'Keys', make('div', {className: 'key-views'}, ...views));
}
byId('help').addEventListener('click', help);
for (const kind of ['undo', 'redo']) byId(kind).addEventListener('click', () => app.tryTo({kind}));

byId('verdict').addEventListener('click', () => open(byId('reasons'), 'Verdict of the adjustment', app.verdict.parts(true)));

// The selected point stands below, and the question about it and the one before
function now() {
  byId('now').textContent = app.selection && `Point ${app.selection}`;
  byId('now').hidden = !app.selection;
  byId('difference').textContent = `Height above ${app.before} (d)`;
  byId('difference').hidden = !app.before || !app.scene?.adjusted;
}
app.addEventListener('selected', now);
byId('now').addEventListener('click', () => show('point'));
byId('difference').addEventListener('click', () => app.orSay(difference(app, app.before, app.selection).then(found => app.say(found))));

byId('take').addEventListener('click', () => app.tryTo({kind: 'take over'}));

function about() {
  const {scene} = app, count = scene.classes.filter(one => one.count).map(one => `${one.count} ${one.name} points`);
  byId('name').textContent = scene.name;
  document.title = `${scene.name} – mgsgraph studio`;
  const words = {project: 'Project', result: 'Results', case: 'Case'}[scene.kind];
  byId('about').textContent = `${words} ${scene.path}: ${scene.images.length} images, ${count.join(', ') || 'no points'}`;
  byId('warning').textContent = scene.warning;
  byId('warning').hidden = !scene.warning;
  byId('locked').firstElementChild.textContent = scene.lock || '';
  byId('locked').hidden = !scene.lock;
  byId('about').title = byId('about').textContent;
  for (const kind of ['undo', 'redo']) {
    const reason = app.refusal || (scene[kind] ? '' : `There is no change to ${kind}.`);
    Object.assign(byId(kind), {hidden: scene.kind !== 'project', disabled: Boolean(reason), title: reason});
  }
}
for (const name of ['opened', 'renewed']) app.addEventListener(name, () => app.verdict.read());
for (const name of ['opened', 'renewed', 'changed', 'worked']) app.addEventListener(name, about);

build();
const opening = app.open();
app.orSay(show('start'));
