"""The script of the value explorer: it draws what `explorer_data` says, at the point that was dragged to."""

from __future__ import annotations

EXPLORER_STYLE = """
.explorer svg{touch-action:pan-y}.explorer .map{touch-action:none;cursor:crosshair;user-select:none}
.x-region{fill:none;stroke-width:1.4}.x-under{fill:none;stroke:#fff;stroke-width:3.2;stroke-opacity:.85}
.explorer .map .region-name{fill:#1b2430;stroke:#fff;stroke-width:3px;stroke-linejoin:round}
.x-handle{fill:#fff;stroke:#111;stroke-width:2.5}
.x-handle:focus{outline:none;stroke-width:4;stroke:var(--run)}
.x-bar{fill:var(--bound)}.x-own{fill:none;stroke:#111;stroke-width:2}.x-blank{fill:none;stroke:var(--line);stroke-width:.5}
.x-cross{stroke:#111;stroke-width:.7;stroke-dasharray:3 3}
.x-path{fill:none;stroke-width:1.3;stroke-opacity:.75}.x-path.lost{stroke-dasharray:3 2}
.x-lost{stroke:var(--bad)!important;
stroke-width:2}.explorer .controls{display:flex;flex-wrap:wrap;gap:8px 16px;align-items:center;margin:10px 0}
.explorer .controls label{font-size:.9rem;color:var(--soft)}.explorer .controls input{vertical-align:middle}
.explorer .controls select{font:inherit;font-size:.88rem;background:var(--card);color:var(--ink);border:1px solid
var(--line);border-radius:6px;padding:2px 6px}.explorer .read{font-size:1.05rem;margin:6px 0;min-height:3em}
.explorer .read b{font-size:1.3rem}section:has(.explorer[hidden]){display:none}
@media print{section:has(.explorer){display:none}}
"""

EXPLORER = """
(function(){var home=document.querySelector(".explorer"),box=document.getElementById("explorer");if(!home||!box)return;
var d=JSON.parse(box.textContent),ns="http://www.w3.org/2000/svg",map=home.querySelector(".map"),flat=d.grid.length<2;
function bytes(text){var raw=atob(text),out=new Uint8Array(raw.length);
for(var k=0;k<raw.length;k++)out[k]=raw.charCodeAt(k);return out.buffer}
var bounds=new Uint32Array(bytes(d.bounds)),values=new Uint32Array(bytes(d.values)),
nx=d.grid[0].length,ny=flat?1:d.grid[1].length,count=nx*ny,at=d.own===null?[d.middle[0],flat?0:d.middle[1]]:[Math.floor(d.own/(flat?1:d.grid[1].length)),
d.own%(flat?1:d.grid[1].length)];
d.panels.forEach(function(p){p.forEach(function(c){c.xy=new Int16Array(bytes(c.points));
c.to=c.turns===null?null:new Int16Array(bytes(c.turns))})});
function make(g,name,set,text){var e=document.createElementNS(ns,name);for(var k in set)e.setAttribute(k,set[k]);
if(text!==undefined)e.textContent=text;g.appendChild(e);return e}
var up=flat?1:(d.high[1]-d.low[1])/(d.high[0]-d.low[0]),wide=d.scaled?Math.min(304,300/up):304,
B={left:46+(304-wide)/2,top:12,width:wide,height:flat?70:d.scaled?wide*up:270};
map.setAttribute("viewBox","0 0 360 "+(B.height+74).toFixed(1));
function px(v){return B.left+(v-d.low[0])/(d.high[0]-d.low[0])*B.width}
function py(v){return flat?B.top+B.height/2:B.top+B.height-(v-d.low[1])/(d.high[1]-d.low[1])*B.height}
function where(i,j){return i*ny+j}
var cells=make(map,"g",{}),over=make(map,"g",{}),w=B.width/nx,h=B.height/ny,rects=[],pick=home.querySelector("select"),
slide=home.querySelector("input[type=range]"),read=home.querySelector(".read");
for(var i=0;i<nx;i++)for(var j=0;j<ny;j++)rects.push(make(cells,"rect",{"class":"cell",x:(B.left+i*w).toFixed(2),
y:(B.top+(ny-1-j)*h).toFixed(2),width:(w+.3).toFixed(2),height:(h+.3).toFixed(2)}));
d.regions.forEach(function(r){var x=px(r.low[0]),y=py(r.high[1]);
["x-under","x-region r-"+r.role].forEach(function(look){make(over,"rect",
{"class":look,x:x,y:y,width:px(r.high[0])-x,height:py(r.low[1])-y,style:"fill-opacity:.5"})});
make(over,"text",{"class":"region-name",x:x+3,y:y+10},r.name)});
make(over,"rect",{x:B.left,y:B.top,width:B.width,height:B.height,fill:"none",stroke:"currentColor"});
function ends(k,x0,y0,x1,y1){make(over,"text",{"class":"tick "+(k?"end":"middle"),x:x0,y:y0},+d.low[k].toPrecision(4));
make(over,"text",{"class":"tick end",x:x1,y:y1},+d.high[k].toPrecision(4))}
ends(0,B.left,B.top+B.height+13,B.left+B.width,B.top+B.height+13);
make(over,"text",{"class":"name middle",x:B.left+B.width/2,y:B.top+B.height+26},"start of "+d.names[0]);
if(!flat){ends(1,B.left-4,B.top+B.height,B.left-4,B.top+8);
make(over,"text",{"class":"name middle",transform:"rotate(-90 "+(B.left-34)+" "+(B.top+B.height/2)+")",
x:B.left-34,y:B.top+B.height/2},
"start of "+d.names[1])}
var lineX=make(over,"line",{"class":"x-cross",y1:B.top,y2:B.top+B.height}),
lineY=make(over,"line",{"class":"x-cross",x1:B.left,x2:B.left+B.width}),
UNKNOWN=4294967295,handle=make(over,"circle",{"class":"x-handle",r:7,tabindex:0,role:"slider","aria-label":"start"});
d.states.forEach(function(name,q){pick.add(new Option(name,q))});
if(d.times.length){slide.max=d.times.length-1}else home.querySelector(".later").hidden=true;
function later(){return d.times.length&&pick.value!=="start"}
function whole(p){if(!later())return bounds[p];return values[(+slide.value*d.states.length+ +pick.value)*count+p]}
function digits(n){var s=String(n).padStart(9,"0"),cut=n>=d.unit?"1":"0."+s.slice(0,6);
if(n<d.unit&&n>.9999*d.unit)cut="0."+s;return cut}
if(d.own!==null){var ox=px(d.grid[0][Math.floor(d.own/ny)]),oy=flat?py(0):py(d.grid[1][d.own%ny]);
over.insertBefore(make(over,"path",{"class":"x-own",d:"M"+(ox-6)+" "+oy+"h12m-6 -6v12"}),handle)}
var bar=make(map,"g",{});
function shade(n,s){var f=Math.max(1-n/d.unit,.5/d.unit),o=n?Math.log10(n/d.unit/f):-9;
return Math.max(0,Math.min(1,(o-s.low)/(s.high-s.low)))}
function colour(){var s=d.scales[later()?1:0],y=B.top+B.height+34,k;for(var p=0;p<count;p++){rects[p].style.fillOpacity=
whole(p)===UNKNOWN?0:(.06+.94*shade(whole(p),s)).toFixed(3)}
bar.textContent="";for(k=0;k<32;k++)make(bar,"rect",{"class":"x-bar",x:B.left+k*B.width/32,y:y,width:B.width/32+.3,height:8,
style:"fill-opacity:"+(.06+.94*(k+.5)/32).toFixed(3)});
s.ticks.forEach(function(t){make(bar,"text",
{"class":"tick "+(t[1]>.93?"end":"middle"),x:B.left+t[1]*B.width,y:y+18},t[0])})}
function show(){var p=where(at[0],at[1]),x=px(d.grid[0][at[0]]),y=flat?py(0):py(d.grid[1][at[1]]),good=0,n=d.episodes;
handle.setAttribute("cx",x);handle.setAttribute("cy",y);
[["x1",x],["x2",x]].forEach(function(s){lineX.setAttribute(s[0],s[1])});
[["y1",y],["y2",y]].forEach(function(s){lineY.setAttribute(s[0],s[1])});
for(var e=0;e<n;e++)good+=d.success[e*count+p];
d.panels.forEach(function(curves,k){var g=home.querySelector('.x-paths[data-panel="'+k+'"]');if(!g)return;
g.textContent="";if(later())return;
curves.forEach(function(c){for(var e=0;e<n;e++){var r=e*count+p,s=[],t=0,b=r*d.length*2,lx,ly;
for(;t<d.length&&c.xy[b+2*t]>=0;t++){lx=c.xy[b+2*t]/10;ly=c.xy[b+2*t+1]/10;s.push(lx+","+ly)}
make(g,"polyline",{"class":"x-path "+c.role+(d.success[r]?"":" lost"),points:s.join(" ")});
if(t){if(d.success[r]){if(c.to)make(g,"polygon",{"class":c.role,points:"6.5,0 -4.5,4 -2.6,0 -4.5,-4",
transform:"translate("+lx+" "+ly+") rotate("+c.to[r]+")"});
else make(g,"circle",{"class":c.role,cx:lx,cy:ly,r:2.2})}
else make(g,"path",{"class":"x-lost",d:"M"+(lx-3)+" "+(ly-3)+"l6 6m0 -6l-6 6"})}}})});
var spot=d.names.map(function(name,k){return name+" = "+(+d.grid[k][at[k]].toPrecision(5))}).join(", ");
read.innerHTML="";var big=document.createElement("b"),value=digits(whole(p));
big.textContent=whole(p)===UNKNOWN?"No bound is known":"P \u2265 "+value;big.dataset.units=whole(p);big.dataset.point=p;
var whence=later()?" certified from here on, at time "+d.times[+slide.value]+" with the automaton in "+
d.states[+pick.value]:whole(p)===UNKNOWN?" from this start, which the certificate is not about":
p===d.own?" certified from this start, which the certificate is about":
d.own!==null?" proved by the check for the same controllers from this start":" certified from this start";
read.append(big,whence+": "+spot+". "+(later()?"":good+" of "+n+" episodes satisfied the task."));
document.querySelectorAll(".x-tube").forEach(function(g){g.style.display=p===d.own?"":"none"});
handle.setAttribute("aria-valuenow",whole(p)===UNKNOWN?0:whole(p)/d.unit);handle.setAttribute("aria-valuetext",read.textContent);
home.querySelector(".when").textContent=later()?"time "+d.times[+slide.value]:"time 0";
slide.disabled=!later()}
function go(i,j){at=[Math.max(0,Math.min(nx-1,i)),Math.max(0,Math.min(ny-1,j))];show()}
function drag(event){var r=map.getBoundingClientRect(),v=map.viewBox.baseVal,
x=(event.clientX-r.left)/r.width*v.width,y=(event.clientY-r.top)/r.height*v.height;
go(Math.floor((x-B.left)/w),flat?0:Math.floor((B.top+B.height-y)/h))}
var held=false;
map.addEventListener("pointerdown",function(e){held=true;try{map.setPointerCapture(e.pointerId)}catch(_){}
e.preventDefault();handle.focus({preventScroll:true});drag(e)});
map.addEventListener("pointermove",function(e){if(held)drag(e)});
["pointerup","pointercancel"].forEach(function(name){map.addEventListener(name,function(){held=false})});
handle.addEventListener("keydown",function(e){var m={ArrowLeft:[-1,0],ArrowRight:[1,0],ArrowUp:[0,1],ArrowDown:[0,-1]};
if(flat){m.ArrowUp=[1,0];m.ArrowDown=[-1,0]}
if(m[e.key]){e.preventDefault();go(at[0]+m[e.key][0],at[1]+m[e.key][1])}});
pick.onchange=slide.oninput=function(){colour();show()};
colour();show();home.hidden=false})();
"""
"""Without it the explorer stays hidden; everything else on the page is there."""
