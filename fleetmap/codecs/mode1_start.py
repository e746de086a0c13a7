"""Start probabilities of payload mode 1, one byte a context; made by ``benchmarks/train_mode1.py``."""

import base64

START = base64.b85decode(
    "6$S?l8b-+X(13t|m12@{li|>SfPjF26%{RF;roDqfPjF2m3pYdfPjF2fPjF2u9nmFfPjF2fPjF2vDAQofPjF2fPjF25eN($EN;ou"
    "?|^`Sgm;W`y2S5*fPjF25)Bwgn(pv`fPjF2Y<7Ul*MNY4fPjF2mZRqIfPjF2fPjF2tJi>lfPjF2fPjF2{eXagfPjF2fPjF2fPjF2"
    "fPjF2fPjF2{rZ4_fPjF2fPjF2fPjF2fPjF2fPjF20{wu1fPjF2fPjF2fPjF2fPjF2fPjF20tFTxBq~2~*ZP2flb^JmdXuW~fPjF2"
    "$%?Yz`+$IefPjF2tit4gfPjF2fPjF2$8w?B{eXagfPjF2kiy=8fPjF2fPjF20s{NufPjF2fPjF2{o;UtfPjF2fPjF29#&mhXpgeu"
    "(}3cDtDvKlw7JBw;(&mF0-mm$x0J`*fPjF2z__%^S=)esfPjF2LZGj&tFGVBfPjF2y}_@!vCx2kfPjF2BV3ZHvai|afPjF2uc*DW"
    "vul8WfPjF24Ioc`u)E9Ux`2Ryg`>N+$K$$yfPjF22n`@lbHLvDfPjF2fQ6r{*X@9SfPjF20|p8qNu1jGx`2RyXM2E~xa+!rfPjF2"
    "0s;pOA5f&(%kO}Ir*V9Jg}%RJfPjF29UUF9x`2RyfPjF2fZMu&fPjF2fPjF2fPjF2fPjF2fPjF2fPjF2fPjF2fPjF2fPjF2fPjF2"
    "fPjF2fPjF2fPjF2fPjF2fPjF2fPjF2fPjF2fPjF2fPjF2fPjF23IYO){eXagfPjF2fIIMjfPjF2fPjF2fPjF2fPjF2fPjF2fPjF2"
    "fPjF2fPjF21p)$~{knjFfPjF2fc@~gfPjF2fPjF2fPjF2fPjF2fPjF2fPjF2fPjF2fPjF21p)%L{knjFfPjF2fTG^IfPjF2fPjF2"
    "pm33<(ffdafPjF2xU9X+fPjF2fPjF23<d}f79T!@tCIDASzeHugM+rL<$!>I0s;b5{knjFfPjF2fWzUsfPjF2fPjF2>a@x3x`2Ry"
    "fPjF2w92}GfPjF2fPjF2;P@(l^!<*2Foq3)JAf~Mpn!mYfPjF2fPjF2fPjF2KsNpT0{#7ffPjME9}hWMc(&5G*(nh!eyw)i?#=="
)
