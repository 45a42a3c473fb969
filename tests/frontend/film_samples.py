"""Films of twelve even pictures, grey levels 20, 38, 56 …, 25 a second, as FFmpeg writes them with encoders that
OpenCV lacks: MPEG-4 and H.264 with B frames, H.264 with three intervals left out after each four pictures, AV1. Packed
by zlib, in base 85."""

from __future__ import annotations

import base64
import zlib
from pathlib import Path

_PACKED = {
    "b_frames.avi": (
        "c-rk*Ur19?82_%DPG#iO1<oEe*h71Y>lQk&)MX6TA6scr`f^7X-NHH27(QH5+we`&G7t(U_#nL%+I*`GA$^!g(3^xC$)1XoAU87C"
        "ckUm%>C>J)KkohR`F-a*zwbNe-tFO>TOPOjQaym{j>mG%)7kZ{8o<vF_WQyCzY_r3Ucn&@6##m<%}5?#(OTd*h}N_LVCd0cKi;BN"
        "IKU6NuY1p{<A{z)ZWHYRybB1WpG9>X-)qCRP2^HO2I@f6syUwf%I%J;b(mYLXt4Z!prD|jprD|jprD|jprD{QQ6T#RS_UA*2mA5z"
        "=T7iikbRnZe0n<EH$0v0u2aP43->nK&o$u1+Qrq%Y3Nr&L2*+5A@1VuKNt!J$WCgz=w;sQqIvhaR@%a4Eajgk%3+;}YK?|g<cna?"
        ";UjL~Zax`X-i>d4+<Xl1)>^6weGPt?i2s4&wW`w(qrXsS<V^54YRy-CN1=np%{@_TK+=j&rlT=dsM=5NwEom33MsRu;K){u6=qs="
        "2VBmakEBPkf~u3mZUNlWDMaZLBUJ;Bsy30VUODR&hgrGGGMFP~KC5Ti5=PMo$x&Nf$rv#)F^x>n<Rjo^OEtup{|#Osx~`&Drk4AZ"
        "JzSVY>$-Yfn&k?gaoaJrFLJ?@-e}=A%7z`uSs^*A-|357#IjaX=tt+qj6-xPp(CP(Q_;w1V{9eNRpJbpHX~j_!d5bBBQxvPrAP~B"
        "HR>$|FV08|TqyoM8#4_PJvf*B;PMZErTKa?ncQY*ORU8%*YZ5W$JmrZzv9T6#(gur!U|#dCc9UOmrdn~*CfR>sYg!x@LjFh^$}~<"
        "ROXuGg%t}joI;N-g<i{AejL3fvlw%>`1((0rk=h$tUqowH>&H`%T>JaZSP^qF9CkIApz1Ug#n~fi*^<FsyG=*4rB&YyoQltl=uh8"
        "U8?>i<jpFcL+(_?J4^o8k0Q6L_<I#6@wp@Mmo?JK&0n5hX+H"
    ),
    "b_frames.mp4": (
        "c-oCsU1%Id9N)_q{lfSVwPLFijY>)Gvb%|AlemyHjYeotEcQW^b#{05cD?<|?%d_B`Ved$QhaGENKN!X6d|<rp;iiFFu_<6DuRe6"
        "v})3a)-T!@wFPa~|7`Y>&4r4?&CGxP|KI<6c8=pXq|>rz2CmI<H5}Vvinyo>w$~|e9JfjL3E{Z9E?dJCFmE-~hvD&y1HVjPUKl+4"
        "M%z4Ec;M=_l9=s8X{5S7K|=NsAO|zRY9D%f;E8l6>O0U6GL5Jp=y$!cMRbZpp6^JDyvWc7rCxV?`^d;hrf6!!wXl<M{aib<n=z<u"
        "0mk*H={i9-Qn7+nNkBf)r4FPK#d6iWBy{uLJi-pP$^nu1Qb#vm5`+$96UiVY6ciMo9z|YI231&PUz3Ck4@$5g+bj`HW)=m|kbUgr"
        "h$Li@YWS{=Wl$9m^@(Mf0Z_Y3yET;pp$^*;4<TUfpz9Dx6xsv<={TUW7vxQkAyy0wd$OzR0ijY_MAYy>gBh}1H;)ZC$ZNd7GF7t1"
        ";F04;K2+1jl*M5>l=v0~5bzbN;N!Bay0(WYoK+|h^|9%I2>|+-VRRqcB!FTmvR4M$)FcsTtYMF3p~#AfnJ3NkNtD+JF>?l0fO0+J"
        "$T`<rWqP2RCuOiLWn)6NO@{@p5{IY-Ds}QGa?R@LlfVGWzACTg3VOaOslJYE1!~Gtf`cT886FL@L?k|w1=3??qaBx|Y!?s#C7#rY"
        "Ob;3amjU_*uJADQo^_HNh5NdljE`}x;qvt_ug$!FrAPd3`Kg|%BY%j)AluP5(QNJc^rzRt&HMkBm$#m~`u#t2`OM6v7mmI&19H?i"
        "vFEYo*LRJzhO3y*yS`Y(%mU`#z6tforN)Q$*W3{<_J^_&&X(`FxcT8TvyCr3&M&SY#;Opd4~|z5OMs|vXh_YmVDIW1pX&X3`TDnK"
        "&!0YW->FxBl`fo|@9ANF?(Um7_sW}lhuT`hOXIooCx+~2Zd0c9`pZiziCl>TjXe}!96$E*zT5wLPi>4snA}ty!cph&x*#WaRU>Zx"
        "nM5Rm{AM%`^2e6qeCFLBKK|;^htpBPCi8KSYeg-5mMm(mVY_Y-u$EmkG;ZCf{h8xZi(HChzqOHCkE%ZRa{oDM;CBozUmob^X+H8<"
        "yU|)|af9an@yoNUqhkxvXux_wtbnd*FuQfJZp{{3GcnV!wd&kOc2~J)=b}T}&@8_qVGm#ud4N5LgV@n5!Z4|i;Iq(yXe!!~(PWq{"
        "+KOz42A^Icjco<rLUDkFfGQTyrve&i3C!E<)xSk4SmKBqgnjUqi0ZLD3}Nj6tNkgB+Y&BucjjO}xiDn(vX;QI?a<s|GMeHVjNcZ2"
        "Kizio#to*}1g}C|(SZvUV*!n-y_!(eXh;;2sPJoJSp&?iOh?_IQ&-VZ6Z}{f?R!CXFp&iF^GV$E7MS<PlhHe4ev-##Q$STWVV~U@"
        "rJzxE6P~k4w6oEi>^j^OAA6patYF$)xmpiSQI{Fq34g)3Qu}?lsAt6tyqW?p{tIwj4Nd"
    ),
    "variable.mkv": (
        "c-pO1eQXnD7{8V=oe&mHAZQQ{!4Hsi*KQWrykzTEWr=0Dj*sBSdA+`Ek6nAWyW7_BkG-yJg^3$M6z7PH4uotXj*lhG*-pfu%>Rsx"
        "sIWm~K?sOKfG9hkw=GnR{^#ZT-t#=~?|I(e?|I+rJ!U@}i`kkrgY72#e$%pSziSWL!cjk~%A!)k+FBsAK{L*DhP(y>U)ehzc6^{F"
        ";*n6x8|xect<Ijv^oo5RXRp?k@@7=;uL19xW8f|D9;rU&b@ql0%_(=5a{wm8*{@tqRU@3l|9@dVC*zUfV9&{gr#@}UwUszRn_pt<"
        "Jywg!3^!$2U3$N-bhl4ix9jKehLhKiEPVa#=tqw3@{Q4w=1{U8R#eg!k64M}&-SNzhfZk*<#_b=+6!;izn>*^YQz(VJDchP?x;pI"
        "x2<9vE9@^8=2ti?^GjEiHED)<=bIu%*IHt9(*cb-s*%-wTGq-d8gaJ|MuOmW^%&g5L;4so!wb*e(+*z=K};fGnA-H^Miep-*}hAo"
        "m-`moxpj-cjXe{Otln_^hNA4`5+U!24tuP{zPzlm++J1Q@(+PZAD3w5GK9S+y6mxN`O2!&>Wa$c<t<w&swjDz7F(#)Ma(HXQdcg-"
        "Bd;>sri^Pu%$CqVIB@OEo~-NJf3#m5yl{G1|GSGu$kX$#Tn$>Rg=8Mdi83P1*5|-nW`a;YZbe=p34MS$H{xKTOq3c0<WWgjt02!p"
        "SuonCs!~yYenUfpsh)QuQD6fmQTFEJx+b6M7XTwlDlZ0<B9dcWEJvG38F}ae(v4h#$kov1B9K6`0aj>K5KRROim0I3TtNB}?L$FQ"
        "sdIs~n3R-8NQIG+-L%<+b;CgV`5<yLxS|;{7?}-t5pA}ToKF`0ECZ=#Qk9V)@CsN<f=k?-3I<o}rzxPoy4Q;VL|e>@%x2QVDk>u>"
        "HN1oosRFeUBYHdvQt3PksrqEdz=Z@+tYLlNFqxPl@EpnnC^8@?*Wh?~GcgZ7pdwjd0R(ZEP$#pE3@7>}Rt2Af7O67J2cQH1Wfo&R"
        "GV4bQZ6RHZ)Ce~3PTH)Sm9PpI<KkJolAD)NQda}wy*||imMEbB;}s>CO$8-LtwD`Yo3^G6#?J>ZaSjC#SEtg26q#Ha_ftlS4{~LW"
        "xu+HKWRB)!59xP7Pq8F$XgIADS&N0xl*tOFgv%zMY>>7t1w&DhL>H301RDg00rn4;VryaV@lN9NNz6pi2=S~war5h|i9O@RmhUGj"
        "i}$r(x75bEHR2iky3H!>m@C-gXIu3g=O4_(l&`Lw`cs`alsNa=maar>uSTrED6+J}_Wazf3nB&jx%c#()pxuT4}7!y=0y8DyQ|j^"
        "xjxwu+oKUdjGSHC!BvdqKIJq%s-G{@KOE5$w>J-VKDl7!>;r3h#sO!TnZ`v@xas<6na=q1q2T`QIZq!N%3b#YH5S{c8A{R$!o*Zi"
        "@Lm6KU;CVo!@tl!^o|r455;z924C_|E~VgH)H~ec@K;T94SFVD7>n)J4DERO@eK7epIb}Meo?jU<x7({eO?QEjMV+SGkmrLHm3QE"
        "V%(bl;(g~v2Dei)hVFH~AkF*C{Q417?5CsOHXR&<&KvjsYv=2ZWjc>P4}<YY?%~7R2igv5ME@rEEL{s5F8-?J3~V_VHk9<Y-i?GO"
        "2{>d7{VkL=|1a1ri_Q"
    ),
    "av1.mp4": (
        "c-nnb&x_MQ6n;rVskL?6ZLQf~5V0#&SxLj<x!{Uj5ClOFDy-9;ge{xdlw>xdr&>MeK^B98$3^hq$)g?xWzQbP_25C!n}2|Z`X))+"
        "w7UC}$(#4h%lE!{nHB&vi{I<CJ%<6vAUyH)I(mb3mg@kJv0T#xkY*SqJex&Ce%pVtre%z&0_@58Wzxf>=lO?S<9ICt)nIjI2YO0D"
        "0~ORCzk7F#a!rwx0E#=v0#X+)f1LXB!6?<_M@qn+4bbN2r{9ceJq1S=*{OyQlLA<Macfrkf^ZrtU-!r1_ehae()%OgnBpkp-;F3L"
        "C+<cR$B+WX;m4>g3kVf=Ay`4l1(+kdno-iHWvntxo_l?^J1f03ih4y+f*1!lef1SU>JoDtA0wOj8x+PY^$V4KM{(jFnKYg?88_fi"
        "!^*P5U9ySu+k7*unfjLv>%!r6{#&;(6i_uO_t4Lqw#P?r#Ju6V(oaU)1ScA!lY2LCsBryL7%Xj2+a0X<ZE7YnZ(!^+$riOuks}4H"
        "y=CE~?6Z(GDYHtWwR!5AR$?2uZP(Uff!93VvT+`G+@pz{o;cYDv_fpU0ZsJH12ZN~?f1o#`1OkqAP0lrMt2P|LVb(7aodV}(E!!s"
        "VM~XqqjLmhRGP%4FqiU<05r7_U1(zGn7clan~VJluH8>46!?PZaC}6{u|G2rpNoAd(z5O(_;nnuZOX-GzRAqc3p<(oq<9Qm(&^aA"
        "_AIrdbF=t{JA!Zl|3Ao}u~&$1T`<nq@z#yM;C7oC"
    ),
}


def write_sample(folder: Path, name: str) -> Path:
    """The film ``name`` in ``folder``."""
    (folder / name).write_bytes(zlib.decompress(base64.b85decode(_PACKED[name])))
    return folder / name
