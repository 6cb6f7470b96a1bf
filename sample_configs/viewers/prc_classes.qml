<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>
<!-- written by docs/generate.py from the class codes; do not edit -->
<qgis styleCategories="Symbology" version="3.22">
  <renderer type="classified" attribute="Classification" pointSymbol="0" pointSize="1" pointSizeUnit="MM" maximumScreenError="0.3" maximumScreenErrorUnit="MM">
    <categories>
      <category render="true" value="0" label="0 never classified" color="180,180,180,255"/>
      <category render="true" value="1" label="1 unclassified" color="180,180,180,255"/>
      <category render="true" value="2" label="2 ground" color="143,69,18,255"/>
      <category render="true" value="5" label="5 vegetation" color="42,157,104,255"/>
      <category render="true" value="6" label="6 building" color="245,80,30,255"/>
      <category render="true" value="7" label="7 noise" color="38,38,38,255"/>
      <category render="true" value="18" label="18 high noise" color="38,38,38,255"/>
      <category render="true" value="64" label="64 stem" color="232,196,24,255"/>
      <category render="true" value="65" label="65 car" color="42,76,194,255"/>
      <category render="true" value="66" label="66 curb" color="252,229,34,255"/>
      <category render="true" value="67" label="67 vertical" color="247,70,19,255"/>
      <category render="true" value="68" label="68 horizontal" color="173,228,187,255"/>
      <category render="true" value="69" label="69 pole" color="166,111,208,255"/>
    </categories>
  </renderer>
</qgis>
