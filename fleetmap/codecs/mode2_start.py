"""Start probabilities of mode 2, and how sure they are: ``benchmarks/train_mode2.py`` makes them."""

import base64
import zlib

START = zlib.decompress(
    base64.b85decode(
        "c-rk*4OA3I5}w%wWS6&&NET($L%b10C8CntfCqahXh1+%6F?AH#h<Jogdat~p9+G40)nD=K~y{y&=@fZq6Tw@h;xdEMn!#&7>TYw"
        "TpmFYAOBp>{;-QbC!o3K%cI`T?pM{--PJwS)m^=9Z3;S-YfA!js_9@y$KBYOv;AEO5h&>Df8ZsAJ)M3BZg9)t{-|P{21X$Zo$d`A"
        "M*2V=wFDnch)F{sa1QXl0GT)zz~30>>yH+i=v#8@$ZE);4gd+J9Fc)ODG(WQABa4mRThPsG3HR93p^giZGj!oD*O_Fna?4?P=w>S"
        "PMtv_WRc5}9v8{<gh<8%(hPt!Mluc$gj|Bd!4TF*&k*$R(D1k*Bv=`a9zFCBY<<>bcqvt3iC8@5j*mh5&iDyz2L4yhP!2#6ehM?u"
        "HPh2YZSTQLF+NAY(MN4qV((+#xGTOI>7-#B@Y&oMx=u)E8BXJyb!me#gzw=E*cGe--=zy6m(#SmFPfIi)wr%sV}nNO$$@@Qvio@K"
        "AlB6dFj@86O-m`PudRJM9Q#s#juJ07vO7H5?&2Ivgza#r9XcNtOU58P7W*L8KeIx_PW%MSTEf}3`H3UKm9BycVnIFBBOFD{FIbjY"
        "=n;r;47YH#%j&Dnwg`uCQZpq**Xv9WzMyk!g?+=1+uvh5D{*V1er<(T1XJ-<p?c==uB<ph5HNcZ)TAC|@q}j(arv>!rwAYCZ>*Zq"
        "*qqd;H1!v#Z-;gS{$&{U89(!i!f_IZk1yjJH!_zIE)W4jRy4X<v7Rp4TxHPER&WsEOC+y}$ZMfG5w6h5y-ir$A?G3d15a8jpdKCj"
        "4&gh@wr0^^It0P2oLKyLNNkfdQG3#4gZezrRUz2VrnyQyn{QK?<o+}D3Bu<5`13k`r}95Qco?tXs&!z+NeW@JLHkefMqWN*i13dE"
        "Mx}a7^C@;Qj^sznlEQqi%2<74ue`m!WfVJc_NG5nUU$tAPe8cHWK{NyDOqL)tf@g{nJ5Y<w#`wzT^=WvFAzUPc#6rw$Ol{Jx-4Yt"
        "PThXmEjMsM7^|O3N~bwndW}UGtuJLowl5<$tFMD7wn-Q_Y5$+TFL4@tlJyNw8uCRWB&<Aqfvs3aU>cr}Fau-|qpCY|u-`{M27bT>"
        "9xIz5XAdH~UcmaBt)aNgVVVUy#*|E#n?_v1zQ?2qg?(Nfau8{=Xv%0%nb8eiMb9Zb*VG@Fd~gf~=$)i{%~(t6*8bJ4X~9oFF7j-@"
        "-;cVEokZl5Lld7d{isXP;Mvm9?;%rke=B<KWLmBjy0CEzc5O_{$XR8sj39eslfKv+uCG)}%-VBqr-V>4N8Jz9#0pdmJU)B3_RQ+P"
        "=_zNvrtDH_hFHmX&%D7TemY30wmbaHrBXL5MK@4=PF`D*pxVhF-+Orfe8?bWNk{9mhc^z5cNohC&925vg}DKKN^_)Jk8H}$QrZbO"
        "i}w{2Sz9QXmWQ_<T}+-lLJ?<Meyh2C{PPK1MM>MQS$j)%O9m_Kwl>xZO$iB+t|Lh`le%_VfTxQ4SQ_Z<rjBVcSWo*Jsu=ryJHlk@"
        "I?|bvZVcW&5&rJ#xVtf7%Zw3>s_g8_q_T->y`QX0g1V#SiQ)oFP}gaIAevSe&9W0`b_el;5}#0>nyLN!Jh6+qwR-xWX8vmCX6KEg"
        "qt%t%sNZjGX@_^=n>O~wcG?TLZ*i<X6W<&1_L}RY^nb6HU?b3Cwu`mi$&;ho^T|H8mWmJ6jM`q8uPG@o?)z?@#L*gd95Ga5%}tR&"
        ")6WI5mY32R=kGNw`Z&2aYF`Ka5)&PkQ<(C<)nY<-E{-ZniQ2gchzKFQ#gUjZ)&E7cwE>&fd(~!352UR~Ut^V?O<aq2-ySzP>p8W+"
        "sqv{E=Q5ok!Zuqb`RQ}w_!<gUO**}1?nZ63#pe5bjP^JVqP^^F(tZ6COsmUK$Qg1zLwb7cCpq0};TH497!bh(7;@^;01OB~ugKBa"
        "HxH_Pb?R2B6@!H&IthBBT#f{uBC|tbk0c?A0d#22M5%#74Mj;81=z1VtZE5QYJL6yG{;-g8#Qm|g#pp#uN`!7zz)gM`~^?SLxD_Y"
        "08O>;%i<qOCZq;(8;aaWkh>t?i(=nGM!DN_YG}5{qXZD;6smoOrIpC$o@zpMkQKhousc8lGdV!LB6083Mk&rRVXsr0r4GwW6s+y5"
        "k44lA=Ob$1WxSJQ+UujPH-P=?)T~vPDj)~QSK}9nRPWtn&wHBzdKYLidfN`b0Y`9xT$J1Kz#V*G15~?2lLtfcqEm`<XKWhN=@d7&"
        "rXXwgmdKJNag*<6Unz<^yzj_KqW$V6SY9nVoRFL1l4ewUEbx@{yM?<Oi1v1d@!1o-Ip)yu;C!FT3Xg3eJ3<mjXloO}vabT8!&a4!"
        "yY_xza#(^NEJU8s(LvL}Wq~nEH@wPD0y*zkl+leqr;rHf09{B1bNCGGf?fT0riaa2w+@2G^E+m3PER|wh%R4o(LUPs`_NLKZx0-s"
        "8AG*7{=KB2@@`yX`30}D(%&rVj@MLOiCtOzjQ40bL)Ocflb0J>TH34&8g9imr=IzyDZSMO`L(ECRtHaA>J4eCiD5{Fl*{XSnRV{h"
        "3WC}J^4+;|9HIE;z92VK+!dOwP+W0zXyhO2u;0_zOKoUw*2tCVP(Z}Xd!gw!v(gq=6HLGo*sQ2a@y8DaMyS`P2Dh8G3Wl1L>m=!Q"
        "W!Pmi4|tKG{_KA-G+pW7j-t~PVZAKxt9-Dgyi3%!u*SO4J+~;bzs6zO%mi&NQkz*T&`LAI&GfWNhG{X$!*n&wx^Y@1@qZqxu{XlP"
        "Q)BRwIp&&@q(vs0k__1tjjx4Dx^IR6B#yqOf<BJas&{HARftBu(2JcT1W>qPw;5|iM)A^w##2#5Ds~q}y=Qn1#O(hsMYQ{Mg2{5%"
        "LqT?ju=Sw<9|bJCjzM%_%7*xL@rB{ngX>4Ozka1)(A8tb@OqYWIEr-+gS#(!dM-*nADY--M=jsz)9oFlJe*LkIHLZeGMIMA6e2Ml"
        "q)4?W*4-#l^$$7dX6)%2k~tCFJj{YhSeKM~<;<Jz#!$4}!GVN_@~UrebzA=hhK@(1"
    )
)

SEEN = zlib.decompress(
    base64.b85decode(
        "c-rk*iI(di2$e<g|G)T&OM)8Hbel8hO_*tmh=__eXku)H&c&I?Ws1=qkSe(PiQsUOsaemw$uMLYmzpGlBuh1vN<!LQlKGg;fU7q2"
        "my-<DM^Dv&)Ap)|uGn*!b&9hbwI}7<M~CM)SXnUqVswSR!xI6tz5s|C&%FDvOXI@Ja~gZ@t6sA<%+3KHL>F?C%O;QB`3G(D>h63A"
        "h7>}O1L3@_$SlvzZCh!9(}FPZ6cSVWC1VrSXARQk|K3)N4w*5I)BMeO-h7B*&>_Ib^E~mMFpULsSg!Sb-EX}d(P4|{yg?~LO7V@W"
        "zCa)=mjW=UDIs*@4U~DxK_kisuU*F+Ke9pAPIlW|BywbnIs#YS*q9X!3WKTtnBr?lbkmP4&C9EEh+R*%#TVKp%t(9u<sk#O_r{B+"
        "z_!M!1yhje(Yh#fYIv=te-19ya9*-QcS0%9Fl@91!M(s>YrH9V(`MtHakH7m!+x0HuuTXl2{N4ucWO(o10Gpp_}bPA7T)<?Yw&@c"
        "4xhyh_@uS30i1OGm^Bee$;&&F*m>QVer4Dl7!LiIC<S;Pzb;PiMLgeeC!LMB<hbEXtpZC<%_rkWYJ8Xy4@&!a(P-A%;7V$)%-)tw"
        "dXEVKVm{-=e3}b|Z^ep<jS0@}05<*qoeb@n2%#um4?kr}`A{vW8eqca=n|7x!H=qTs#BfM-}B6K16iJg>~4CO?m4{a!LGlob_F(f"
        "SZ)ZsN{e91kKkU6KM*03qXP6IrQW0*t~<78H}=Aten&{yzp(RHC@jQ!>58*Fzcx6qoRYx^aGuy$FU6Lw)52RspYkLLqmJI>`}`)v"
        "d-V<z5k0=Lq>7g?z#*90-vb8mAS)cd&*kMf)E)CaaoN)j@%432+<wb<i<gn~QW+q4^(V5fETKS2f1y6C7<#C}kKpO>rsm|B`AWf_"
        "MrC<U?N6{|3%)xY$S=q(wtv59BDo6lrrDk%a%1+7A5CYNb>pskXrwH0Tm;lykLUIB+@^*4?gthrY65=n!VVY;#Dl&a0|Z3gPSlcz"
        "O}xE#X9P&k2<&e@{{iC-G6w"
    )
)
