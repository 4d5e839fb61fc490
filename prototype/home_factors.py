"""prototype: home bearings as factors of each solution"""
import sys,math,os,numpy as np
from benchmarks.cost import hall_drive
from benchmarks.measures import figures
from homeward.localizer.localizer import Localizer
from homeward.localizer.map.smoother import Smoother
from homeward.localizer.motions import NC
from homeward.track import run as follow
import homeward.localizer.home.tracker as HT
orig=Smoother._add_more
def add_more(self):
    base=orig(self); hf=getattr(self,'_hf',None)
    if hf is None: return base
    ids,b,sg,home=hf
    ok=np.isin(ids,self.ids); ids,b,sg=ids[ok],b[ok],sg[ok]; idx=self.index(ids)
    if len(ids)<4: return base
    def add(e,poses,shared):
        if base is not None: base(e,poses,shared)
        at=NC+2*idx; L=np.stack([shared[at],shared[at+1]],1)
        h=hf[3].copy()
        for _ in range(3):  # home given the landmarks, with their uncertainty ignored: gauss-newton
            d=L-h[:2]; q=(d**2).sum(1); r=(b-np.arctan2(d[:,1],d[:,0])+h[2]+np.pi)%(2*np.pi)-np.pi
            Jh=np.column_stack([d[:,1]/q,-d[:,0]/q,-np.ones(len(q))])/sg[:,None]
            h=h+np.linalg.lstsq(Jh,r/sg,rcond=None)[0] if False else h
        d=L-h[:2]; q=(d**2).sum(1); r=((b-np.arctan2(d[:,1],d[:,0])+h[2]+np.pi)%(2*np.pi)-np.pi)/sg
        w=1/np.maximum(np.abs(r)/4.,1.); r=r*w; s=w/sg
        Jh=np.column_stack([d[:,1]/q,-d[:,0]/q,-np.ones(len(q))])*s[:,None]
        Jl=np.zeros((len(q),len(shared))); k=np.arange(len(q)); Jl[k,at]=-d[:,1]/q*s; Jl[k,at+1]=d[:,0]/q*s
        A=Jh.T@Jh+1e-6*np.eye(3); G=np.linalg.solve(A,Jh.T)   # eliminate home (no prior)
        M=Jl-Jh@(G@Jl); rr=r-Jh@(G@r)
        e.common[:]+=Jl.T@M; e.common_slope[:]+=Jl.T@rr
        hf[3][:]=h+G@r if False else h
        hf_step[0]=(h,G,r,Jl)
    return add
hf_step=[None]
Smoother._add_more=add_more
if __name__=='__main__':
    secs=float(sys.argv[1])
    for seed in map(int,sys.argv[2:]):
        d=hall_drive(secs,24,seed,float(os.environ.get("TS","0.02"))); L=Localizer(d.home,**d.settings.robot); last=[0]
        def see(e):
            h=L.chart.home; f=h.hypotheses; s=L.chart.map.smoother; lm=L.chart.map.landmarks
            if f is not None and f.rivals(3.)<.01 and f.best.inliers.sum()>=5:
                b=f.best; names=[h.names[i] for i in np.flatnonzero(b.inliers)]
                names=[n for n in names if n in lm.mapped]
                ids=np.array([lm.mapped[n].number for n in names]); o=ids.argsort(); names=[names[i] for i in o]; ids=ids[o]
                s._hf=(ids,np.array([h.observation.bearings[n].bearing if hasattr(h.observation.bearings[n],'bearing') else h.observation.bearings[n] for n in names]),np.full(len(ids),.011),np.asarray(b.home,float)[:3].copy())
            if os.environ.get('V') and e.t-last[0]>=40:
                last[0]=e.t; tp=np.array([np.asarray(v).item() for v in d.truth.at(np.array([e.t]))])
                if e.pose is not None:
                    off=np.array(e.pose)-tp; P=e.covariance; print(f"{e.t:.0f} err {math.hypot(*off[:2]):.2f} sd {math.sqrt(P[0,0]+P[1,1]):.2f} h {math.remainder(off[2],math.tau)/math.sqrt(P[2,2]):+.1f} in {f.best.inliers.sum()}/{len(h.names)} yaw {s.state.calibration[7]:.4f}",flush=True)
        f=figures(follow(d,L,on_estimate=see),d.truth)
        print(seed,' '.join(f"{k} {f[k]:.3f}" for k in ('pose','sure','rmse','nees_position','inside3','wrong')),flush=True)
